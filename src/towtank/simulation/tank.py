"""The simulated tank session of the demo: a small ROV, one axis after the other, under motion capture.

The learner is told what a builder knows, the rigid body and the bench curves of the thrusters, and none of the
coefficients. A pilot keeps the vehicle inside a tank of four to five metres: depth hold, except where heave itself is
excited, and a way back to the middle in the rest between two axes. Where a payload is wanted, all axes are driven at
once afterwards, and the vehicle takes it up on the way. A second session with every axis at once, which the learner
never sees, is there to judge the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import euler_from_quaternion
from towtank.core.forces import add_inflow_damping_into
from towtank.core.layout import I_INFLOW
from towtank.core.rk4 import simulate_run
from towtank.recording import Recording
from towtank.simulation import MANOEUVRES, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate, usual_amplitudes
from towtank.vehicle import Provenance, Vehicle, allocate, configuration_matrix, load_vehicle, thruster_wrench

__all__ = [
    "ALL",
    "DELAY",
    "DISTURBANCE",
    "DURATION",
    "FREE",
    "MOCAP",
    "PAYLOAD_TAIL",
    "SEED",
    "WEIGHT",
    "Session",
    "tank_session",
    "unseen_session",
]

SEED = 1
DURATION = 180.0  # s
UNSEEN_DURATION = 30.0  # s
DELAY = 0.05  # s, from a command to its force
MOCAP = Mocap(rate=100.0, noise_mm=1.0, noise_mrad=1.0)  # and jumps of 10-50 mm for 1.4 % of the time
DISTURBANCE = OrnsteinUhlenbeck(std=(0.25, 0.25, 0.25, 0.02, 0.02, 0.02), time_constant=2.0)  # N, N m
FREE = (
    "X_udot",
    "X_uu",
    "Y_vdot",
    "Y_vv",
    "Z_wdot",
    "Z_ww",
    "K_pdot",
    "K_pp",
    "M_qdot",
    "M_qq",
    "N_rdot",
    "N_rr",
    "BG_z",
)
WEIGHT = "W_minus_B"  # learned as well where a payload is taken up
PAYLOAD_TAIL, _TAKEN = 60.0, 15.0  # s, all axes at once, and of these before the payload is taken up
ALL = "all axes"
_DT = 0.01  # s
_LOOK = 10  # steps between two looks of the pilot
_DEPTH = 3.0  # m, of the middle of the tank
_REST = 0.15  # of the time of an axis, half of it before and half after
_PULL, _BRAKE = 0.9, 1.3  # of the pilot: 1/s^2 of the way to go, 1/s of the velocity, both times the inertia
_SOFT = 0.25  # of that pull, for the depth hold while another axis is excited
_ITS_OWN = ("heave", "pitch")  # axes that need heave for themselves
_BENCH = 0.005  # to which the bench knows the scale of the thrusters' force
_HEAVIER, _MORE_DRAG, _SINKS = 2.0, 1.3, 2.0  # kg along surge, sway, heave; times the drag there; N, of a payload


@dataclass(frozen=True)
class Session:
    """One simulated session.

    Attributes:
        truth: the vehicle that was simulated. known: what the learner is told about it.
        recording: pose and commands, as a log would hold them.
        turns: name, start and end [s] of every axis' turn; empty where all are excited at once.
        changed: when [s] the vehicle became the other one, `later`; none where it stayed what it was.
    """

    truth: Vehicle
    known: Vehicle
    recording: Recording
    turns: tuple[tuple[str, float, float], ...]
    changed: float = math.inf
    later: Vehicle | None = None

    def truth_at(self, t: float) -> Vehicle:
        """Return what the vehicle is at time t [s]."""
        return self.truth if self.later is None or t < self.changed else self.later

    @property
    def final(self) -> Vehicle:
        """What the vehicle is in the end."""
        return self.truth if self.later is None else self.later

    def axis_at(self, t: float) -> str:
        """Return the axis whose turn it is at time t [s], or "" in the rest between two."""
        for name, start, end in self.turns:
            rest = 0.5 * _REST * (end - start)
            if start + rest <= t < end - rest:
                return name
        return ""


def tank_session(duration: float = DURATION, seed: int = SEED, *, payload: bool = False) -> Session:
    """Return the session that is learned from: all axes in turn; then all at once, where a payload is taken up."""
    truth = _truth()
    wrench = manoeuvre("tank-session", truth, duration=duration, dt=_DT, seed=seed).wrench
    axes = MANOEUVRES["tank-session"].axes
    share = duration / len(axes)
    turns = tuple((axis, k * share, (k + 1) * share) for k, axis in enumerate(axes))
    if not payload:
        return _simulated(truth, _steered([(0.0, truth)], wrench, turns, seed), turns, seed)
    more = manoeuvre("all-multisine", truth, duration=PAYLOAD_TAIL, dt=_DT, seed=seed).wrench
    wrench, turns = np.vstack([wrench, more]), (*turns, (ALL, duration, duration + PAYLOAD_TAIL))
    change = round(duration + _TAKEN, 1), _loaded(truth)
    return _simulated(truth, _steered([(0.0, truth), change], wrench, turns, seed), turns, seed, change)


def unseen_session(seed: int = SEED + 1, *, payload: bool = False) -> Session:
    """Return the session that judges the model: sums of sines on all axes at once, other noise, no pilot."""
    truth = _loaded(_truth()) if payload else _truth()
    plan = manoeuvre("all-multisine", truth, duration=UNSEEN_DURATION, dt=_DT, seed=seed)
    commands = plan.commands
    if payload or commands is None:
        commands = allocate(truth, plan.wrench - np.array([0.0, 0.0, truth.weight_minus_buoyancy, 0.0, 0.0, 0.0]))
    return _simulated(truth, commands, (), seed)


def _truth() -> Vehicle:
    return load_vehicle("vlbv300").model_copy(update={"command_delay": DELAY})


def _loaded(bare: Vehicle) -> Vehicle:
    """Return the vehicle with a payload: heavier along surge, sway and heave, with more drag, and sinking."""
    values = {name: bare.coefficient(name) - _HEAVIER for name in ("X_udot", "Y_vdot", "Z_wdot")}
    values |= {name: _MORE_DRAG * bare.coefficient(name) for name in ("X_uu", "Y_vv", "Z_ww")}
    return bare.with_coefficients({**values, WEIGHT: bare.coefficient(WEIGHT) + _SINKS})


def _known(truth: Vehicle) -> Vehicle:
    """Return the vehicle without its coefficients and its delay: rigid body and thrusters."""
    return truth.model_copy(
        update={
            "description": "SeaBotix vLBV300: rigid body and thrusters; coefficients learned in the simulated session",
            "hydrodynamics": {},
            "command_delay": 0.0,
            "scale_std": _BENCH,
            "buoyancy": truth.buoyancy.model_copy(update={"centre": truth.rigid_body.centre_of_gravity, "source": ""}),
            "provenance": Provenance(source="towtank demo, a simulated tank session"),
        }
    )


def _simulated(
    truth: Vehicle,
    commands: Array,
    turns: tuple[tuple[str, float, float], ...],
    seed: int,
    change: tuple[float, Vehicle] | None = None,
) -> Session:
    start = (0.0, 0.0, _DEPTH, 0.0, 0.0, 0.0)
    recording = simulate(
        truth,
        commands=commands,
        dt=_DT,
        eta0=start,
        sensors=MOCAP,
        disturbance=DISTURBANCE,
        changes=() if change is None else [change],
        seed=seed,
    )
    return Session(truth, _known(truth), recording, turns, *(change or ()))


def _steered(
    bodies: Sequence[tuple[float, Vehicle]], wrench: Array, turns: tuple[tuple[str, float, float], ...], seed: int
) -> Array:
    """Return the commands (n, m) of a plan's wrench (n, 6) with the pilot's, who looks ten times a second.

    Args:
        bodies: what the vehicle is, each from a time [s] on.
    """
    n = len(wrench)
    truth = bodies[0][1]
    push = DISTURBANCE.sample(n, _DT, seed)
    wait = round(truth.command_delay / _DT)
    inertia, limit = np.diag(truth.mass_matrix), usual_amplitudes(truth)
    asked, acting = wrench.copy(), np.zeros((n + wait, 6))
    given = _given(truth, limit)
    parameters = [(when, np.array(body.parameters)) for when, body in bodies]
    still, state = np.zeros(3), np.zeros(13)
    state[2], state[3] = _DEPTH, 1.0
    B = configuration_matrix(truth)
    forces_of = np.linalg.pinv(B)
    pulls = _pull(_DT * np.arange(0, n, _LOOK, dtype=np.float64), turns)
    for look, first in enumerate(range(0, n, _LOOK)):
        last = min(first + _LOOK, n)
        p = [each for when, each in parameters if when <= _DT * first + 1e-9][-1].copy()
        asked[first:last] += given @ np.clip(inertia * _towards_middle(state, pulls[look]), -limit, limit)
        acting[first + wait : last + wait] = asked[first:last]
        add_inflow_damping_into(B, forces_of @ acting[first:last].mean(axis=0), p[I_INFLOW], p)
        state = simulate_run(p, state, (acting[first:last] + push[first:last])[:, None, :], _DT, still)[-1]
    return allocate(truth, asked)


def _given(truth: Vehicle, size: Array) -> Array:
    """Return the wrench that the thrusters give for a unit on each axis (6, 6): surge comes with a pitching moment."""
    out = np.zeros((6, 6))
    for row in np.flatnonzero(size):
        asked = np.where(np.arange(6) == row, size, 0.0)
        out[:, row] = thruster_wrench(truth, allocate(truth, asked)) / size[row]
    return out


def _pull(t: Array, turns: tuple[tuple[str, float, float], ...]) -> Array:
    """Return how hard the pilot steers (n, 6), 0 .. 1 per axis of the wrench, at times t (n,) [s]."""
    out = np.zeros((t.size, 6))
    out[:, 2] = _SOFT
    out[:, [0, 1, 2, 5]] = 1.0
    for name, start, end in turns:
        rest = 0.5 * _REST * (end - start)
        busy = (t >= start + rest) & (t < end - rest)
        out[busy] = 0.0
        out[busy, 2] = 0.0 if name in _ITS_OWN else _SOFT
        if name == ALL:
            out[busy] = np.array([_SOFT, _SOFT, _SOFT, 0.0, 0.0, _SOFT])
    return out


def _towards_middle(state: Array, pull: Array) -> Array:
    """Return the accelerations (6,) [m/s^2, rad/s^2] that lead to the middle of the tank, heading north."""
    w, x, y, z = state[3:7]
    psi = euler_from_quaternion(w, x, y, z)[2]
    middle = np.array([0.0, 0.0, _DEPTH]) - state[:3]
    c, s = math.cos(psi), math.sin(psi)
    way = np.array([c * middle[0] + s * middle[1], c * middle[1] - s * middle[0], middle[2], 0.0, 0.0, -psi])
    out: Array = pull * (_PULL * pull * way - _BRAKE * state[7:])
    return out
