"""The delay between command and force is found by scanning, at any rate of commands, with the thrusters' lag known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from towtank.identification import learn_paper
from towtank.identification.least_squares.batch import DelayCost, scan_delay
from towtank.identification.posterior.assembly import DelayScan
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

from .runs import box

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))


def scan(cost: Callable[[float], float], longest: float) -> DelayScan:
    return scan_delay(lambda delay: DelayCost(cost(delay)), longest)


def test_the_scan_finds_the_bottom_between_its_steps() -> None:
    tried: list[float] = []

    def cost(delay: float) -> float:
        tried.append(delay)
        return 4000.0 * (delay - 0.1234) ** 2

    found = scan(cost, 0.4)
    assert found.delay == pytest.approx(0.1234, abs=1e-6)
    assert not found.at_limit
    assert len(tried) == len(set(tried)) < 40
    assert (np.diff(found.delays) > 0).all()


def test_its_deviation_is_that_of_a_mean_over_blocks_that_differ() -> None:
    """Every block of time has its own best delay; the whole has their mean, and that mean's deviation."""
    best = 0.2 + 0.02 * np.random.default_rng(1).standard_normal(200)
    found = scan_delay(lambda d: DelayCost(float(np.sum(50 * (d - best) ** 2)), [50 * (d - best) ** 2]), 0.4)
    assert found.delay == pytest.approx(best.mean(), abs=1e-6)
    assert found.std == pytest.approx(0.02 / np.sqrt(200), rel=0.4)


def test_the_ends_of_the_range() -> None:
    assert scan(lambda d: d, 0.4).delay == 0.0
    far = scan(lambda d: -d, 0.4)
    assert far.delay == pytest.approx(0.4)
    assert far.at_limit
    assert np.isnan(far.std)
    assert scan(lambda d: 0.0, 0.4).delay == 0.0
    assert scan(lambda d: (d - 0.013) ** 2, 0.03).delay == pytest.approx(0.013, abs=1e-6)
    assert scan(lambda d: d, 0.0).delay == 0.0


def vessel(lag: float = 0.0) -> Vehicle:
    vehicle = load_vehicle("vlbv300")
    thrusters = tuple(thruster.model_copy(update={"time_constant": lag}) for thruster in vehicle.thrusters)
    return vehicle.model_copy(update={"thrusters": thrusters})


def orders(vehicle: Vehicle, hold: int, seconds: float = 15.0) -> np.ndarray:
    commands = manoeuvre("all-telegraph", vehicle, duration=seconds, seed=1).commands
    assert commands is not None
    return np.repeat(commands[::hold], hold, axis=0)[: len(commands)]


@pytest.mark.parametrize("sensors", ["perfect", Mocap()], ids=["perfect", "mocap"])
@pytest.mark.parametrize("hold", [1, 10], ids=["100 Hz", "10 Hz"])
@pytest.mark.parametrize("delay", [0.0, 0.037, 0.15])
def test_the_delay_is_found(delay: float, hold: int, sensors: str | Mocap) -> None:
    vehicle = vessel()
    log = simulate(
        vehicle, commands=orders(vehicle, hold, seconds=30.0), delay=delay, sensors=sensors, disturbance=TANK, seed=2
    )
    learning = learn_paper(vehicle, [log], instruments=False)
    assert learning.delay == pytest.approx(delay, abs=0.010)
    assert learning.model.command_delay == learning.delay
    assert learning.delay_scan is not None
    assert not learning.warnings or "delay" not in learning.warnings[0]


def test_a_known_lag_is_not_taken_for_delay() -> None:
    truth = vessel(lag=0.1)
    log = simulate(truth, commands=orders(truth, 10), delay=0.05, sensors=Mocap(), seed=5)
    knowing, ignorant = (learn_paper(v, [log], instruments=False) for v in (truth, vessel()))
    assert knowing.delay == pytest.approx(0.05, abs=0.012)
    assert ignorant.delay > 0.10  # the lag answers for delay where it is not modelled
    total = truth.mass_matrix[0, 0]
    share = [abs(total - _total(learning, truth)) / total for learning in (knowing, ignorant)]
    assert share[0] < 0.03


def _total(learning: object, truth: Vehicle) -> float:
    estimate = learning.estimate  # type: ignore[attr-defined]
    return float(truth.rigid_body_matrix[0, 0] - estimate["X_udot"].value)


def test_a_given_delay_is_honoured_and_none_scanned() -> None:
    vehicle = vessel()
    log = simulate(vehicle, commands=orders(vehicle, 1), delay=0.1)
    right = learn_paper(vehicle, [log], delay=0.1, instruments=False)
    wrong = learn_paper(vehicle, [log], delay=0.0, instruments=False)
    assert right.delay_scan is None
    assert right.delay == 0.1
    total = vehicle.mass_matrix[5, 5] - vehicle.rigid_body_matrix[5, 5]
    assert -right.estimate["N_rdot"].value == pytest.approx(total, rel=0.02)
    assert abs(-wrong.estimate["N_rdot"].value / total - 1.0) > 0.05


def test_a_delay_beyond_the_range_is_told() -> None:
    vehicle = vessel()
    log = simulate(vehicle, commands=orders(vehicle, 1), delay=0.3)
    learning = learn_paper(vehicle, [log], longest_delay=0.1, instruments=False)
    assert any("end of the range" in text for text in learning.warnings)


def test_a_poor_run_does_not_claim_a_sharp_delay() -> None:
    """A slow sine under a slow disturbance says little of delays; its deviation has to own up to that."""
    for seed in (1, 3):
        push = np.zeros((4000, 6))
        push[:, 0] = 20 * np.sin(0.8 * np.arange(4000) * 0.01)
        found = learn_paper(
            box(), [simulate(box(), wrench=push, disturbance=TANK, seed=seed)], instruments=False
        ).delay_scan
        assert found is not None
        assert found.delay < max(0.010, 4.0 * found.std)


def test_a_delay_that_had_to_be_found_widens_what_depends_on_it() -> None:
    vehicle = vessel()
    log = simulate(vehicle, commands=orders(vehicle, 1, seconds=40.0), delay=0.06, sensors=Mocap(), seed=2)
    given = learn_paper(vehicle, [log], delay=0.06).estimate
    found = learn_paper(vehicle, [log])
    assert found.delay_scan is not None
    assert found.delay_scan.std >= 0.0025
    for name in ("X_udot", "N_rdot", "N_rr"):
        assert found.estimate[name].std > 0.9 * given[name].std
    assert any(found.estimate[name].std > 1.1 * given[name].std for name in given.names if given[name].identified)
    masses = {each.name: each.std for each in found.estimate.sums}
    assert masses["I_z - N_rdot"] == pytest.approx(found.estimate["N_rdot"].std)
