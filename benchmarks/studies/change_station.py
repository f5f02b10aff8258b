"""A vehicle that is held in place for hours, changed unseen, and moved again; see `change_cases`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from change_cases import WRENCH, feed
from change_vehicles import FREE, two_kilograms_more
from experiments import experiment

from towtank.core.arrays import Array
from towtank.core.attitude import eulers_from_quaternions
from towtank.identification import Learner
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.simulation.inputs import initial_states
from towtank.simulation.integration import simulate_pieces
from towtank.vehicle import Vehicle, thruster_wrench

__all__ = ["station"]

_BASE = 150.0  # s of motion before
_STEP = 0.05  # s
_PART = 600.0  # s between two readings


def station(seed: int, hours: float = 8.0) -> dict[str, Any]:
    """Hold a vehicle in place for hours, change it, move it again; return what was noticed and what drifted.

    A coefficient drifts where its error grows, in deviations that it had; one that comes nearer is learned.
    """
    case = experiment("coupled-pose")
    truth, other = case.truth, two_kilograms_more(case.truth)
    learner = Learner(case.start, free=FREE)
    moving = manoeuvre("all-telegraph", truth, duration=_BASE, dt=_STEP, seed=39)
    wrench = moving.wrench if moving.wrench is not None else _wrench_of(truth, np.asarray(moving.commands))
    first = simulate(truth, wrench=wrench, dt=_STEP, sensors=Mocap(), disturbance=WRENCH, seed=seed)
    learner.run(first)
    start = _standing(learner)
    right = np.array([truth.coefficient(name) for name in learner.estimate.names])
    t, drift, trace, events = _BASE, 0.0, [], len(learner.events)
    state = np.zeros(12)
    for part in range(round(3600.0 * hours / _PART)):
        run, state = _held(truth, state, _PART, seed * 1000 + part)
        if part == 0:
            learner.restart()
        feed(learner, run, t)
        t += _PART
        now = _standing(learner)
        worse = (np.abs(now[0] - right) - np.abs(start[0] - right)) / start[1]
        drift = max(drift, float(np.max(worse)))
        trace.append(float(np.sum((now[1] / start[1]) ** 2)) / now[1].size)
    false = len(learner.events) - events
    again = np.roll(wrench, -500, axis=0)[: round(30.0 / _STEP)]
    last = simulate(
        other,
        wrench=again,
        dt=_STEP,
        sensors=Mocap(),
        disturbance=WRENCH,
        seed=seed + 7,
        eta0=state[:6],
        nu0=state[6:],
    )
    before = len(learner.events)
    feed(learner, last, t)
    late = [float(event.details.get("noticed", event.t)) - t for event in learner.events[before:]]
    return {
        "hours": hours, "false": false, "drift": drift, "trace": max(trace), "noticed": min(late, default=np.inf),
        "texts": [event.text for event in learner.events],
    }  # fmt: skip


def _standing(learner: Learner) -> tuple[Array, Array]:
    estimate = learner.estimate
    return np.array(estimate.values), np.array(estimate.std)


def _wrench_of(vehicle: Vehicle, commands: Array) -> Array:
    return np.asarray(thruster_wrench(vehicle, commands))


def _held(vehicle: Vehicle, state: Array, seconds: float, seed: int) -> tuple[Any, Array]:
    """Hold a vehicle in place by feedback of its measured pose; return the recording and its state at the end (12,)."""
    gain = np.array([8.0, 8.0, 8.0, 0.0, 0.0, 0.4])
    damping = np.array([25.0, 25.0, 25.0, 0.3, 0.3, 0.5])
    n = round(seconds / _STEP)
    push = WRENCH.sample(n, _STEP, seed)
    noise = np.random.default_rng(seed).standard_normal((n, 6)) * 1e-3
    poses, wrenches = np.empty((n, 6)), np.empty((n, 6))
    eta, nu = state[:6].copy(), state[6:].copy()
    shown = eta + noise[0]
    rate = np.zeros(6)
    for k in range(n):
        last, shown = shown, eta + noise[k]
        poses[k] = shown
        rate += 0.2 * ((shown - last) / _STEP - rate)
        c, s = np.cos(shown[5]), np.sin(shown[5])
        error = np.array([c * shown[0] + s * shown[1], -s * shown[0] + c * shown[1], *shown[2:]])
        speed = np.array([c * rate[0] + s * rate[1], -s * rate[0] + c * rate[1], *rate[2:]])
        wrenches[k] = -gain * error - damping * speed
        eta, nu = _step(vehicle, eta, nu, wrenches[k] + push[k])
    return _Held(np.arange(n) * _STEP, poses, wrenches), np.concatenate([eta, nu])


def _step(vehicle: Vehicle, eta: Array, nu: Array, tau: Array) -> tuple[Array, Array]:
    tau3 = np.broadcast_to(tau, (1, 3, 6)).copy()
    states = simulate_pieces(
        np.array(vehicle.parameters), initial_states(eta, nu), tau3, np.array([_STEP]), np.zeros(3)
    )
    x = states[-1]
    return np.concatenate([x[:3], eulers_from_quaternions(x[None, 3:7])[0]]), x[7:].copy()


@dataclass
class _Channel:
    t: Array
    values: Array


class _Held:
    """A recording's channels, as `feed` asks for them."""

    def __init__(self, t: Array, poses: Array, wrenches: Array) -> None:
        names = ("x", "y", "z", "phi", "theta", "psi", "X", "Y", "Z", "K", "M", "N")
        self._values = dict(zip(names, np.column_stack([poses, wrenches]).T, strict=True))
        self._t = t

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __getitem__(self, name: str) -> _Channel:
        return _Channel(self._t, self._values[name])
