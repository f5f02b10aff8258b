"""The posterior over everything plausible: right from mass, inertia and thrusters alone, and good to go on from."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.identification import LogLearning, learn_recordings
from towtank.identification.data.samples import N_MEASURED, NoiseLevels
from towtank.identification.kalman import passes
from towtank.identification.model.parameters import MARKER_PLACE
from towtank.identification.model.prior import prior_of
from towtank.identification.posterior.result import NARROWED
from towtank.identification.posterior.statistics import Reading, widened
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle, save_vehicle

FORCE = (0.25, 0.25, 0.25, 0.02, 0.02, 0.02)  # N, N m
DELAY, LAG = 0.06, 0.15  # s
RATE, DT = 50.0, 0.02  # Hz, s


def inputs(vehicle: Vehicle, *, delay: float = DELAY, lag: float = LAG) -> Vehicle:
    """The vehicle with thrusters that come late and slowly."""
    slow = tuple(thruster.model_copy(update={"time_constant": lag}) for thruster in vehicle.thrusters)
    return vehicle.model_copy(update={"thrusters": slow, "command_delay": delay})


def told(vehicle: Vehicle) -> Vehicle:
    """What a user has: mass, inertia, thruster curves."""
    bare = inputs(vehicle, delay=0.0, lag=0.0).model_copy(update={"hydrodynamics": {}, "scale_std": None})
    return bare.model_copy(update={"buoyancy": load_vehicle("vlbv300").buoyancy})


def dive(truth: Vehicle, kind: str, seed: int, seconds: float = 30.0, **more: object) -> Recording:
    """A run that begins with half a second of rest."""
    commands = manoeuvre(kind, truth, duration=seconds, dt=DT, seed=seed).commands
    assert commands is not None
    commands = np.vstack([np.zeros((round(0.5 / DT), commands.shape[1])), commands])
    water = OrnsteinUhlenbeck(std=FORCE, time_constant=2.0)
    settings = {"sensors": Mocap(rate=RATE), "disturbance": water, "seed": seed, **more}
    return simulate(truth, commands=commands, dt=DT, **settings)  # type: ignore[arg-type]


# -- what windows contradict each other


def readings(rng: np.random.Generator, apart: float, n: int = 4, windows: int = 16) -> list[Reading]:
    """What windows of rows y = a x + e tell one after the other of x (n,), the errors `apart` times as large as told.

    The first coordinate is never measured by itself: only its difference to the second.
    """
    P, x, out = np.diag(np.arange(1.0, n + 1.0) ** 2), np.zeros(n), []
    truth = np.linalg.cholesky(P) @ rng.standard_normal(n)
    out.append(Reading(0.0, x.copy(), P.copy()))
    for _ in range(windows):
        a = rng.standard_normal((30, n))
        a[:, 0] = -a[:, 1]
        shift = apart * np.linalg.cholesky(a.T @ a + 1e-9 * np.eye(n)) @ rng.standard_normal(n)
        information = np.linalg.inv(P)
        view = information @ x + a.T @ a @ truth + shift
        P = np.asarray(np.linalg.inv(information + a.T @ a))
        x = P @ view
        out.append(Reading(0.0, x.copy(), P.copy()))
    return out


@pytest.mark.parametrize("apart", [1.0, 3.0])
def test_windows_that_differ_too_much_widen_the_posterior_by_as_much(apart: float) -> None:
    rng = np.random.default_rng(0)
    factors, ratios = [], []
    for _ in range(200):
        run = readings(rng, apart)
        covariance, factor = widened(run)
        factors.append(factor)
        ratios.append(np.sqrt(np.diag(covariance) / np.diag(run[-1].covariance)))
    middle = float(np.median(factors))
    assert middle == pytest.approx(apart, rel=0.08)
    assert np.median(np.array(ratios)[:, 2:]) == pytest.approx(apart, rel=0.1)


def test_what_only_the_prior_tells_is_not_widened_and_what_was_told_together_stays_together() -> None:
    run = readings(np.random.default_rng(1), 3.0)
    covariance, _ = widened(run)
    before = run[-1].covariance
    unknown, known = np.array([1.0, 1.0, 0.0, 0.0]), np.array([1.0, -1.0, 0.0, 0.0])
    direction = np.linalg.solve(run[0].covariance, unknown)
    assert direction @ covariance @ direction == pytest.approx(direction @ before @ direction, rel=1e-2)
    assert 2.0 < np.sqrt(known @ covariance @ known / (known @ before @ known)) < 5.0
    assert (np.linalg.eigvalsh(run[0].covariance - covariance) > -1e-9).all()  # never wider than the prior


# -- nothing is held


def random_vehicle(seed: int) -> Vehicle:
    """A vehicle of which nobody knows: inertias, damping, couplings, trim, and each thruster off by 5 %."""
    rng = np.random.default_rng(seed)
    start = load_vehicle("vlbv300")
    values = {name: start.coefficient(name) * rng.uniform(0.6, 1.5) for name in start.hydrodynamics}
    values |= {"X_u": -4.0, "Y_v": -6.0, "Z_w": -5.0, "K_p": -0.15, "M_q": -0.2, "N_r": -0.15}
    values |= {"Y_rdot": 0.6, "X_qdot": -0.4, "N_v": -0.3, "Y_r": 0.3, "M_w": 0.2, "X_u2": 5.0}
    values |= {"W_minus_B": 0.8 * rng.standard_normal(), "BG_x": 0.2 * rng.standard_normal(), "N_0": 0.01}
    slow = inputs(start.with_coefficients(values))
    gains = np.exp(0.05 * rng.standard_normal(len(slow.thrusters)))
    off = tuple(t.model_copy(update={"gain": float(g)}) for t, g in zip(slow.thrusters, gains, strict=True))
    return slow.model_copy(update={"thrusters": off})


def truth_of(vehicle: Vehicle, learning: LogLearning) -> dict[str, tuple[float, float, float]]:
    """Value, deviation and truth of everything that was learned of the vehicle."""
    found = {c.name: (c.value, c.std, vehicle.coefficient(c.name)) for c in learning.estimate.coefficients}
    found["delay"] = learning.delay, learning.delay_std, vehicle.command_delay
    found["lag"] = learning.lag, learning.lag_std, vehicle.thrusters[0].time_constant
    for each in vehicle.thrusters:
        found[f"gain_{each.name}"] = (*learning.gains[each.name], each.gain)
    return found


@cache
def learned(seed: int) -> tuple[Vehicle, LogLearning]:
    truth = random_vehicle(seed)
    log = dive(truth, "all-telegraph", seed, 40.0, current=(0.1, -0.08, 0.0))
    return truth, learn_recordings(told(truth), [log])


SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
def test_told_mass_inertia_and_thrusters_alone_nothing_is_far_off(seed: int) -> None:
    truth, learning = learned(seed)
    off = {name: (value - true) / std for name, (value, std, true) in truth_of(truth, learning).items()}
    assert {name: round(each, 1) for name, each in off.items() if abs(each) > 4.0} == {}
    assert learning.current is not None
    assert (np.abs(learning.current.velocity - [0.1, -0.08, 0.0]) < 4.0 * learning.current.std).all()
    for name in ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot"):
        i = "uvwpqr".index(name[2])
        assert learning.estimate[name].identified
        assert learning.model.mass_matrix[i, i] == pytest.approx(truth.mass_matrix[i, i], rel=0.12)
    assert sum(c.identified for c in learning.estimate.coefficients) >= 35


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    within, total = 0, 0
    for seed in SEEDS:
        found = truth_of(*learned(seed))
        within += sum(abs(value - true) <= 1.96 * std for value, std, true in found.values())
        total += len(found)
    assert total > 50 * len(SEEDS)
    assert within >= 0.90 * total


def test_everything_plausible_is_among_the_unknowns() -> None:
    truth, learning = learned(0)
    prior = prior_of(told(truth), more=MARKER_PLACE)
    assert set(learning.narrowed) == set(prior.names)
    assert {c.name for c in learning.estimate.coefficients} == set(prior.vehicle_values)
    assert {"Y_rdot", "N_v", "BG_x", "BG_y", "inflow_loss", "X_u2", "N_0"} <= set(prior.names)


def test_identified_is_what_the_data_have_narrowed_to_half_or_less() -> None:
    for seed in SEEDS:
        _, learning = learned(seed)
        assert learning.prior is not None
        assert len(learning.prior.reference) == len(learning.narrowed)
        for c in learning.estimate.coefficients:
            assert c.identified == (learning.narrowed[c.name] <= NARROWED)
            assert c.identified == (c.reason is None)
            assert 0.0 < learning.narrowed[c.name] <= 1.0 + 1e-9
    assert any(not c.identified for c in learned(0)[1].estimate.coefficients)


def test_what_meets_a_bound_keeps_its_deviation() -> None:
    """Linear damping of which there is none comes out of either sign; it is dissipative, and as uncertain as it was."""
    truth = inputs(load_vehicle("vlbv300"))
    learning = learn_recordings(told(truth), [dive(truth, "all-telegraph", 1)])
    posterior = learning.model.posterior
    assert posterior is not None
    beyond = [name for name, mean in zip(posterior.names, posterior.mean, strict=True) if mean > 0.0]
    at_bound = [learning.estimate[name] for name in ("X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r") if name in beyond]
    assert len(at_bound) >= 2
    for c in at_bound:
        assert c.std == pytest.approx(posterior.std[posterior.names.index(c.name)], rel=2e-3)
        assert abs(c.value - truth.coefficient(c.name)) < 3.0 * c.std
        assert learning.model.deviation(c.name) == c.std
    for name in ("X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r"):
        assert learning.model.coefficient(name) <= 0.0


def test_inputs_without_delay_and_lag_are_found_so() -> None:
    """To first order a lag of 0.2 s that comes 0.2 s early is none at all; no delay is below zero."""
    truth = inputs(load_vehicle("vlbv300"), delay=0.0, lag=0.0)
    learning = learn_recordings(told(truth), [dive(truth, "all-telegraph", 1)])
    assert 0.0 <= learning.delay < 0.004
    assert 0.0 < learning.lag < 0.004
    for name in ("X_udot", "N_rdot", "Y_vv"):
        c = learning.estimate[name]
        assert abs(c.value - truth.coefficient(name)) < 3.0 * c.std


# -- a sensor that is late


def test_a_late_dvl_is_found_and_costs_nothing() -> None:
    truth = inputs(load_vehicle("vlbv300"))
    for seed in (1, 2):
        log = dive(truth, "all-telegraph", seed, sensors=Ins(imu_rate=RATE))
        late = log.replace([replace(log[name], t=log[name].t + 0.12) for name in ("u", "v", "w")])
        learning = learn_recordings(told(truth), [late])
        latency, std = learning.latency["velocity"]
        assert std < 0.01
        assert abs(latency - 0.12) < 3.0 * std
        off = {name: (value - true) / s for name, (value, s, true) in truth_of(truth, learning).items()}
        assert {name: round(each, 1) for name, each in off.items() if abs(each) > 4.0} == {}


# -- names


def test_of_what_is_not_named_the_prior_s_mean_stays() -> None:
    truth = inputs(load_vehicle("vlbv300"))
    known = told(truth)
    learning = learn_recordings(known, [dive(truth, "all-telegraph", 1, 15.0)], free=("X_udot", "X_uu"))
    assert learning.estimate.names == ("X_udot", "X_uu")
    assert set(learning.narrowed) == {"X_udot", "X_uu", "delay", "lag"}
    before = prior_of(known).vehicle_values
    assert len(before) > 40
    for name, value in before.items():
        if name not in ("X_udot", "X_uu"):
            assert learning.model.coefficient(name) == value, name
    assert any("everything else is fixed at the prior's mean" in text for text in learning.remarks)


# -- one log after the other


@cache
def logs(pair: int) -> tuple[Vehicle, list[Recording]]:
    truth = inputs(load_vehicle("vlbv300"))
    return truth, [
        dive(truth, kind, 2 * pair + k) for k, kind in enumerate(("all-telegraph", "all-multisine"), start=1)
    ]


def means(learning: LogLearning) -> dict[str, float]:
    """Mean of each unknown's coordinate, gains as multiples of what the file of the first vehicle says."""
    posterior = learning.model.posterior
    assert posterior is not None
    out = dict(zip(posterior.names, posterior.mean, strict=True))
    return out | {f"gain_{t.name}": float(np.log(t.gain)) for t in learning.model.thrusters}


def differences(pair: int, folder: Path) -> dict[str, float]:
    """How far two logs in turn, by way of a file, are from both at once: deviations of each unknown."""
    truth, runs = logs(pair)
    both = learn_recordings(told(truth), runs)
    save_vehicle(learn_recordings(told(truth), runs[:1]).model, folder / "first.toml")
    second = learn_recordings(load_vehicle(folder / "first.toml"), runs[1:])
    assert both.model.posterior is not None
    std = dict(zip(both.model.posterior.names, both.model.posterior.std, strict=True))
    one, other = means(both), means(second)
    assert set(one) == set(other) == set(std)
    return {name: (other[name] - one[name]) / std[name] for name in one}


@pytest.mark.parametrize("pair", range(3))
def test_two_logs_in_turn_are_both_at_once_at_the_same_levels(
    pair: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is random is as large in both: so they weigh alike, and nothing but the first posterior's shape is lost."""
    noise = np.full(N_MEASURED, 1e-3)
    disturbance = np.array(FORCE) / np.diag(logs(pair)[0].mass_matrix)

    def same(state: object, levels: NoiseLevels, *rest: object, **more: object) -> NoiseLevels:
        return NoiseLevels(noise, disturbance, np.zeros(6), 0.0 * levels.waves)

    def not_widened(run: list[Reading]) -> tuple[Array, float]:
        return run[-1].covariance, 1.0

    monkeypatch.setattr(passes, "adapt_noise", same)
    monkeypatch.setattr(passes, "widened", not_widened)
    off = np.abs(list(differences(pair, tmp_path).values()))
    assert off.size > 50
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.95) < 0.2  # of all that hangs on the common scale of force


def test_two_logs_in_turn_are_both_at_once_but_for_what_each_finds_of_its_noise(tmp_path: Path) -> None:
    off = [np.abs(list(differences(pair, tmp_path).values())) for pair in range(3)]
    every = np.concatenate(off)
    assert every.max() < 1.0
    assert np.median(every) < 0.1  # from pair to pair 0.06 to 0.09
    assert np.quantile(every, 0.95) < 0.65
