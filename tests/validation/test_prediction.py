"""Free-running prediction: perfect where the model is, restarted where asked, and never an exception."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.recording import Recording, align
from towtank.simulation import Ins, Mocap, manoeuvre, simulate
from towtank.validation import CHANNELS, predict, validate
from towtank.vehicle import Vehicle, load_vehicle

TRUTH = {
    "X_udot": -10.0, "Y_vdot": -20.0, "Z_wdot": -25.0, "K_pdot": -0.5, "M_qdot": -0.6, "N_rdot": -0.8,
    "X_uu": -30.0, "Y_vv": -60.0, "Z_ww": -70.0, "K_pp": -1.0, "M_qq": -1.5, "N_rr": -2.0,
}  # fmt: skip


def box(**hydrodynamics: float) -> Vehicle:
    return Vehicle(
        name="box",
        rigid_body={"mass": 20.0, "inertia": (1.0, 1.2, 1.5)},  # type: ignore[arg-type]
        buoyancy={"centre": (0.0, 0.0, -0.02)},  # type: ignore[arg-type]
        hydrodynamics={**TRUTH, **hydrodynamics},  # type: ignore[arg-type]
    )


def pushes(n: int = 2000, hold: int = 1) -> np.ndarray:
    t = np.arange(n) // hold * hold * 0.01
    sizes, rates = (20, 30, 25, 1, 2, 3), (0.8, 1, 0.6, 1.3, 1.1, 0.9)
    return np.column_stack([a * np.sin(w * t + w) for a, w in zip(sizes, rates, strict=True)])


def run(n: int = 2000, **more: Any) -> Recording:
    return simulate(box(), wrench=pushes(n), **{"dt": 0.01, **more})


def test_a_perfect_model_predicts_perfectly() -> None:
    judged = validate(box(), [run()])
    assert set(judged.fit) == set(CHANNELS)
    assert min(judged.fit.values()) > 99.9999  # type: ignore[type-var]
    assert max(judged.rmse.values()) < 1e-6  # type: ignore[type-var]
    assert judged.window == (0.0, 20.0)
    assert judged.horizon is None
    assert judged.predictions[0].restarts == (0.0,)


@pytest.mark.parametrize("start", [0.0, 7.3])
def test_it_starts_from_the_state_that_was_measured(start: float) -> None:
    judged = validate(box(), [run()], window=(start, 15.0))
    assert min(judged.fit.values()) > 99.999  # type: ignore[type-var]
    assert judged.window == pytest.approx((start, 15.0))


@pytest.mark.parametrize("rate", [10.0, 4.0])
def test_coarse_recordings_are_integrated_in_substeps(rate: float) -> None:
    log = simulate(box(), wrench=pushes(4000, hold=50), dt=0.01)
    thin = Recording.from_table(
        log["u"].t[:: round(100 / rate)], {name: log[name].values[:: round(100 / rate)] for name in CHANNELS}
    ).replace([log[name] for name in "XYZKMN"])
    assert min(validate(box(), [thin]).fit.values()) > 99.9  # type: ignore[type-var]


def test_thrusters_delay_and_lag() -> None:
    vehicle = load_vehicle("vlbv300")
    thrusters = tuple(thruster.model_copy(update={"time_constant": 0.12}) for thruster in vehicle.thrusters)
    truth = vehicle.model_copy(update={"thrusters": thrusters, "command_delay": 0.15})
    commands = manoeuvre("all-telegraph", truth, duration=20.0).commands
    assert commands is not None
    commands = np.vstack([np.zeros((50, commands.shape[1])), commands])  # at rest for a start
    log = simulate(truth, commands=commands)
    exact = validate(truth, [log]).fit
    assert exact["u"] == pytest.approx(100.0, abs=0.01)
    assert exact["r"] == pytest.approx(100.0, abs=0.01)
    for wrong in ({"command_delay": 0.0}, {"thrusters": vehicle.thrusters}):
        assert validate(truth.model_copy(update=wrong), [log]).fit["r"] < 97.0  # type: ignore[operator]


def test_a_delay_of_commands_is_not_a_delay_of_wrenches() -> None:
    """As in `simulate`: a recorded wrench is what acted."""
    vehicle = box().model_copy(update={"command_delay": 0.15})
    assert validate(vehicle, [simulate(vehicle, wrench=pushes())]).fit["u"] == pytest.approx(100.0, abs=1e-3)


def test_a_horizon_restarts_from_the_measurement() -> None:
    log = run()
    wrong = box(X_uu=-60.0, N_rr=-6.0)
    free, short = validate(wrong, [log]), validate(wrong, [log], horizon=2.0)
    assert np.allclose(short.predictions[0].restarts, np.arange(0.0, 20.0, 2.0))
    assert short.horizon == 2.0
    for name in ("u", "r", "x", "psi"):
        assert short.fit[name] > free.fit[name]  # type: ignore[operator]
    measured, predicted = short.predictions[0].channels["u"]
    assert abs(measured[201] - predicted[201]) < 0.05 < np.abs(measured - predicted).max()


def test_the_end_of_a_horizon_is_judged_and_its_start_is_not() -> None:
    """Rows that are the measurement itself say nothing: with a horizon of one step every row is a prediction still."""
    log = run(500)
    wrong = box(X_uu=-300.0, X_udot=-200.0)
    prediction = predict(wrong, align(log), horizon=0.01)
    measured, predicted = prediction.channels["u"]
    assert np.count_nonzero(measured == predicted) < 10


@pytest.mark.parametrize("horizon", [0.0, -1.0, np.nan])
def test_a_horizon_that_is_none(horizon: float) -> None:
    with pytest.raises(InputError, match="horizon"):
        validate(box(), [run(200)], horizon=horizon)


def test_an_endless_horizon_is_no_horizon() -> None:
    assert validate(box(), [run(200)], horizon=np.inf).fit == validate(box(), [run(200)]).fit


def test_channels_that_are_not_measured_are_none() -> None:
    log = run(sensors=Mocap(noise_mm=0.0, noise_mrad=0.0, jump_fraction=0.0))
    judged = validate(box(), [log])
    assert [name for name, fit in judged.fit.items() if fit is None] == list("uvwpqr")
    assert [name for name, error in judged.rmse.items() if error is None] == list("uvwpqr")
    assert min(fit for fit in judged.fit.values() if fit is not None) > 85.0  # its first velocity comes from poses
    gyros = run().without(*"xyzuvw", "phi", "theta", "psi")
    only = validate(box(), [gyros]).fit
    assert [name for name, fit in only.items() if fit is not None] == ["p", "q", "r"]


def test_slow_sensors_are_judged_where_they_have_a_sample() -> None:
    log = run(sensors=Ins())
    prediction = validate(box(), [log]).predictions[0]
    assert np.isfinite(prediction.channels["u"][0]).sum() == len(log["u"])
    assert np.isfinite(prediction.channels["r"][0]).sum() == len(log["r"])


def test_angles_are_compared_around_the_circle() -> None:
    wrench = np.zeros((3000, 6))
    wrench[:, 5] = 3.0  # round and round
    log = simulate(box(), wrench=wrench, eta0=(0, 0, 0, 0, 0, 3.0))
    assert np.abs(log["psi"].values[-1]) > 2 * np.pi
    psi = log["psi"]
    wrapped = log.replace([type(psi)("psi", psi.t, np.angle(np.exp(1j * psi.values)), psi.unit, psi.frame)])
    for one in (log, wrapped):
        judged = validate(box(), [one])
        assert judged.fit["psi"] == pytest.approx(100.0, abs=1e-3)
        assert judged.rmse["psi"] == pytest.approx(0.0, abs=1e-4)
        measured, predicted = judged.predictions[0].channels["psi"]
        assert np.abs(measured - predicted).max() <= np.pi


@pytest.mark.parametrize("horizon", [None, 3.0])
def test_a_model_that_diverges_is_told_not_raised(horizon: float | None) -> None:
    judged = validate(box(X_uu=500.0, N_rr=300.0), [run()], horizon=horizon)
    assert judged.fit["u"] == -999.0
    assert all(fit is None or -999.0 <= fit <= 100.0 for fit in judged.fit.values())
    assert all(error is None or np.isfinite(error) for error in judged.rmse.values())


def test_gaps_in_the_measurement() -> None:
    log = run()
    holed = log.window(0.0, 8.0)
    later = log.window(11.0, 20.0)
    joined = Recording(
        {
            name: type(channel)(
                name, np.concatenate([channel.t, later[name].t]), np.concatenate([channel.values, later[name].values]),
                channel.unit, channel.frame,
            )
            for name, channel in holed.channels.items()
            if name not in "XYZKMN"
        }
    ).replace([log[name] for name in "XYZKMN"])  # fmt: skip
    judged = validate(box(), [joined])
    assert min(judged.fit.values()) > 99.99  # type: ignore[type-var]
    assert np.isnan(judged.predictions[0].channels["u"][0][900])
    assert np.isfinite(judged.predictions[0].channels["u"][1][900])


def test_several_recordings_together_and_what_is_refused() -> None:
    judged = validate(box(), [run(), run(500)])
    assert len(judged.predictions) == 2
    assert min(judged.fit.values()) > 99.99  # type: ignore[type-var]
    with pytest.raises(InputError, match="at least one"):
        validate(box(), [])
    with pytest.raises(InputError, match="neither thruster commands nor a wrench"):
        validate(box(), [run(200).without(*"XYZKMN")])


def test_a_wrench_of_fewer_components() -> None:
    wrench = np.zeros((1000, 6))
    wrench[:, 0] = 20 * np.sin(0.01 * np.arange(1000))
    log = simulate(box(), wrench=wrench).without("Y", "Z", "K", "M", "N")
    assert validate(box(), [log]).fit["u"] == pytest.approx(100.0, abs=1e-6)


def thrusted(lag: float, **hydrodynamics: float) -> Vehicle:
    """The box with one thruster that pushes it forward."""
    thruster = {
        "name": "aft", "position": (-0.3, 0.0, 0.0), "direction": (1.0, 0.0, 0.0), "time_constant": lag,
        "curve": {"kind": "quadratic", "forward": 40.0, "reverse": 40.0},
    }  # fmt: skip
    return Vehicle.model_validate({**box(**hydrodynamics).model_dump(), "thrusters": [thruster]})


def test_a_run_begins_when_lagging_thrusters_have_forgotten_what_nobody_recorded() -> None:
    truth = thrusted(0.2)
    log = simulate(truth, commands=np.where(np.arange(1000) % 300 < 150, 0.5, -0.5)[:, None], dt=0.01)
    cut = log.window(1.6, 10.0)  # the thruster turned round 0.1 s before, which the rest of the log does not tell
    judged = validate(truth, [cut], horizon=2.0)
    assert judged.predictions[0].restarts == pytest.approx((2.2, 3.6, 5.6, 7.6, 9.6))
    assert (judged.fit["u"] or 0.0) > 95.0


def test_models_are_set_back_at_the_same_instants_whatever_their_lag_and_delay() -> None:
    log = simulate(thrusted(0.2), commands=np.full((1000, 1), 0.5), dt=0.01)
    for lag, delay, begin in ((0.0, 0.0, 0.0), (0.2, 0.0, 0.6), (0.0, 0.3, 0.3), (0.3, 1.0, 1.9), (50.0, 5.0, 5.5)):
        first, *others = predict(thrusted(lag), align(log), horizon=2.0, delay=delay).restarts
        assert first == pytest.approx(begin, abs=0.011)
        assert others == pytest.approx([k for k in (2.0, 4.0, 6.0, 8.0) if k > first])


@pytest.mark.parametrize("horizon", [None, 3.0])
@pytest.mark.parametrize("step", [1, 5])
def test_a_free_run_by_commands_loses_thrust_with_inflow(step: int, horizon: float | None) -> None:
    truth, bare = thrusted(0.1, inflow_loss=0.3), thrusted(0.1)
    commands = np.where(np.arange(3000) % 700 < 400, 0.9, -0.6)[:, None]
    log = simulate(truth, commands=commands, dt=0.01, nu0=(0.3, 0.2, 0.0, 0.0, 0.0, 0.1))
    thin = Recording.from_table(log["u"].t[::step], {name: log[name].values[::step] for name in CHANNELS})
    fits = [validate(each, [thin.replace([log["cmd_aft"]])], horizon=horizon).fit["u"] or 0.0 for each in (truth, bare)]
    assert fits[0] > 99.5
    assert fits[1] < 97.0


def test_a_free_run_by_a_wrench_loses_nothing_with_inflow() -> None:
    judged = [validate(box(inflow_loss=loss), [run()]).fit for loss in (0.0, 0.3)]
    assert judged[0] == judged[1]
