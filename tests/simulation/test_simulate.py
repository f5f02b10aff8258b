"""The simulator against the core kernel and an independent integration; inputs, errors, reproducibility."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.core.attitude import quaternion_from_euler
from towtank.core.rk4 import simulate_run
from towtank.errors import InputError
from towtank.recording import read_csv, read_parquet
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate
from towtank.vehicle import thruster_wrench

from .vessels import LINEAR, reference, table, vessel

ETA0 = np.array([1.0, -2.0, 3.0, 0.2, -0.3, 7.0])
NU0 = np.array([0.3, -0.2, 0.1, 0.2, -0.1, 0.4])


def wrenches(n: int, seed: int = 1) -> np.ndarray:
    held = np.random.default_rng(seed).normal(size=(-(-n // 10), 6)) * [10.0, 8.0, 8.0, 0.5, 0.5, 1.0]
    return np.repeat(held, 10, axis=0)[:n]


def orders(n: int, seed: int = 2) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(-60.0, 60.0, size=(-(-n // 5), 6)), 5, axis=0)[:n]


def smooth(t: Any) -> np.ndarray:
    t = np.asarray(t)[..., None]
    sines = np.sin(t * np.array([1.0, 1.3, 0.7, 2.0, 1.7, 0.9]) + 0.3)
    return np.asarray(np.array([8.0, 6.0, 5.0, 0.4, 0.4, 0.7]) * sines)


def test_truth_is_the_core_kernel() -> None:
    vehicle, tau, current = vessel(), wrenches(200), np.array([0.2, -0.1, 0.05])
    run = simulate(vehicle, wrench=tau, dt=0.01, eta0=ETA0, nu0=NU0, current=current)
    state0 = np.concatenate([ETA0[:3], quaternion_from_euler(*ETA0[3:]), NU0])
    states = simulate_run(np.array(vehicle.parameters), state0, tau[:, None], 0.01, current)
    found = table(run, ("x", "y", "z", "u", "v", "w", "p", "q", "r"))
    np.testing.assert_allclose(found, states[:, [0, 1, 2, *range(7, 13)]], atol=1e-12)
    q = np.array([quaternion_from_euler(*angles) for angles in table(run, ("phi", "theta", "psi"))])
    np.testing.assert_allclose(np.abs(np.sum(q * states[:, 3:7], axis=1)), 1.0, atol=1e-12)


def test_layout_of_the_record() -> None:
    run = simulate(vessel(), wrench=wrenches(50), dt=0.02, eta0=ETA0)
    np.testing.assert_allclose(run["u"].t, 0.02 * np.arange(51))
    np.testing.assert_allclose(run["X"].t, 0.02 * np.arange(50))
    np.testing.assert_array_equal(table(run, "XYZKMN"), wrenches(50))
    assert run["psi"].values[0] == pytest.approx(7.0)  # whole turns stay
    assert run["u"].t is run["x"].t
    assert not run["u"].values.flags.writeable
    commanded = simulate(vessel(), commands=orders(50), record=("wrench",))
    assert {"cmd_ap", "cmd_vs", "X", "N"} <= set(commanded.names)
    np.testing.assert_allclose(table(commanded, "XYZKMN"), thruster_wrench(vessel(), orders(50)), atol=1e-12)
    assert "X" not in simulate(vessel(), commands=orders(50))


def test_angles_are_continuous_over_many_turns() -> None:
    run = simulate(vessel(), wrench=lambda t: np.multiply.outer(np.ones_like(t), [0, 0, 0, 0, 0, 3.0]), duration=20.0)
    psi = run["psi"].values
    assert psi[-1] > 10.0
    assert np.abs(np.diff(psi)).max() < 0.05


def test_continuous_wrench_against_dop853() -> None:
    rov = vessel(hydrodynamics=LINEAR)
    run = simulate(rov, wrench=smooth, duration=4.0, dt=0.01, eta0=ETA0, nu0=NU0)
    exact = reference(rov, smooth, np.arange(5.0), np.concatenate([ETA0, NU0]))
    np.testing.assert_allclose(table(run)[::100], exact, atol=2e-8)
    middle = smooth(run["X"].t + 0.005)
    np.testing.assert_allclose(table(run, "XYZKMN"), middle, atol=2e-4)  # the mean of each step


@pytest.mark.parametrize("substeps", [1, 3])
def test_order_of_the_integration(substeps: int) -> None:
    def end(dt: float, substeps: int) -> np.ndarray:
        rov = vessel(hydrodynamics=LINEAR)
        found = simulate(rov, wrench=smooth, duration=2.0, dt=dt, substeps=substeps, nu0=NU0)
        return np.asarray(table(found)[-1])

    fine = end(0.005, 4)
    errors = [np.abs(end(dt, substeps) - fine).max() for dt in (0.04, 0.02)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.35)


def test_free_motion_and_energy_loss() -> None:
    run = simulate(vessel(), duration=5.0, nu0=NU0)
    M = vessel().mass_matrix
    nu = table(run, "uvwpqr")
    assert nu[-1] @ M @ nu[-1] < 0.2 * (nu[0] @ M @ nu[0])
    assert not table(run, "XYZKMN").any()


def test_a_current_carries_a_free_vehicle_along() -> None:
    run = simulate(vessel(), duration=60.0, current=(0.3, -0.2, 0.0), eta0=(0, 0, 0, 0, 0, 1.0), dt=0.05)
    c, s = np.cos(run["psi"].values[-1]), np.sin(run["psi"].values[-1])
    u, v = run["u"].values[-1], run["v"].values[-1]
    np.testing.assert_allclose([c * u - s * v, s * u + c * v], [0.3, -0.2], atol=0.02)


def test_a_held_wrench_may_be_cut_short_but_not_be_too_short() -> None:
    assert simulate(vessel(), wrench=wrenches(100), duration=0.5).end == pytest.approx(0.5)
    with pytest.raises(InputError, match=r"100 rows of 0\.01 s, expected at least 200 rows"):
        simulate(vessel(), wrench=wrenches(100), duration=2.0)


def test_same_seed_same_record_and_sensors_do_not_change_the_motion() -> None:
    push = OrnsteinUhlenbeck(0.5)
    settings: dict[str, Any] = {"commands": orders(300), "disturbance": push, "record": ("disturbance",)}
    first, again = (simulate(vessel(), **settings, sensors="ins", seed=5) for _ in range(2))
    assert first == again
    other = simulate(vessel(), **settings, sensors="mocap", seed=5)
    np.testing.assert_array_equal(first["X_disturbance"].values, other["X_disturbance"].values)
    exact, bare = (simulate(vessel(), **settings, sensors=s, seed=5) for s in (None, Mocap(1.0 / 0.01, 0, 0, 0)))
    np.testing.assert_array_equal(table(exact, "xyz"), table(bare, "xyz"))
    assert first != simulate(vessel(), **settings, sensors="ins", seed=6)


def test_the_disturbance_acts_as_a_wrench() -> None:
    pushed = simulate(vessel(), duration=2.0, disturbance=OrnsteinUhlenbeck(1.0), record=("disturbance",), seed=3)
    push = np.column_stack([pushed[f"{axis}_disturbance"].values for axis in "XYZKMN"])
    np.testing.assert_allclose(table(simulate(vessel(), wrench=push)), table(pushed), atol=1e-13)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("sensors", ["perfect", "ins"])
def test_round_trip_through_a_file(tmp_path: Path, suffix: str, sensors: str) -> None:
    run = simulate(vessel(), commands=orders(200), sensors=sensors, eta0=ETA0)
    run.write(tmp_path / f"run{suffix}")
    again = (read_csv if suffix == ".csv" else read_parquet)(tmp_path / f"run{suffix}")
    assert set(again.names) == set(run.names)
    for name in run.names:
        np.testing.assert_array_equal(again[name].values, run[name].values)
        np.testing.assert_array_equal(again[name].t, run[name].t)


def test_progress_goes_to_the_end_and_is_not_chatty() -> None:
    reports: list[tuple[int, int]] = []
    simulate(vessel(), duration=50.0, progress=lambda done, total: reports.append((done, total)))
    assert reports[-1] == (5000, 5000)
    assert len(reports) < 100


@pytest.mark.parametrize(
    "arguments, complaint",
    [
        ({}, "duration: needed"),
        ({"wrench": np.zeros((5, 6)), "commands": np.zeros((5, 6))}, "not both"),
        ({"wrench": np.zeros((5, 5))}, r"wrench: found shape \(5, 5\), expected \(n, 6\)"),
        ({"commands": np.zeros((5, 4))}, r"commands: found shape \(5, 4\), expected \(n, 6\)"),
        ({"wrench": np.full((5, 6), np.nan)}, "wrench: found nan at"),
        ({"wrench": np.zeros((0, 6))}, "at least one row"),
        ({"wrench": "abc"}, "wrench: expected numbers"),
        ({"wrench": lambda t: np.zeros(6), "duration": 1.0}, "the function gave shape"),
        ({"wrench": smooth, "duration": 1.0, "delay": 0.1}, "shift the time"),
        ({"duration": 1.0, "dt": 0.0}, "dt: found 0 s"),
        ({"duration": 0.001}, "at least one step"),
        ({"duration": 1.0, "delay": -1.0}, "delay: found"),
        ({"duration": 1.0, "substeps": 0}, "substeps"),
        ({"duration": 1.0, "seed": -1, "sensors": "mocap"}, "seed: found -1"),
        ({"duration": 1.0, "sensors": "mocup"}, 'did you mean "mocap"'),
        ({"duration": 1.0, "record": ("wrenches",)}, 'did you mean "wrench"'),
        ({"duration": 1.0, "eta0": np.zeros(3)}, "eta0: found shape"),
        ({"duration": 1.0, "voltage": 12.0}, "give commands"),
        ({"commands": np.zeros((5, 6)), "voltage": np.ones(4)}, r"voltage: found shape \(4,\), expected"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        simulate(vessel(), **arguments)


@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning", "ignore:invalid value:RuntimeWarning")
def test_a_vehicle_that_feeds_on_its_drag_is_reported() -> None:
    unstable = vessel().with_coefficients({"X_uu": 300.0})
    with pytest.raises(InputError, match=r"vessel: the motion grows beyond all bounds at t = "):
        simulate(unstable, duration=60.0, nu0=(1.0, 0, 0, 0, 0, 0))


def test_commands_need_thrusters() -> None:
    with pytest.raises(InputError, match="vessel has no thrusters"):
        simulate(vessel(thrusters=()), commands=np.zeros((5, 0)))
