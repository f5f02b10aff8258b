"""What a run will make known: the covariance of all unknowns along a run that has not been driven.

The joint filter itself goes along the noise-free motion of a vehicle drawn from what is known, linearised about it: its
covariance does not depend on what is measured, so that it is the posterior's to first order, and a bound that no
estimator beats. All that a learning leaves free is unknown here too: delay, lag, gains, biases, latencies, the random
force. Mehra, Optimal input signals for parameter estimation, IEEE TAC 19 (1974).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.identification.data.samples import NoiseLevels, Samples, held_forces
from towtank.identification.kalman.passes import one_pass
from towtank.identification.kalman.problem import JointProblem, settings_for
from towtank.identification.kalman.state import FilterSettings, coefficient_block
from towtank.identification.model.prior import Prior, further_unknowns, prior_of
from towtank.identification.model.terms import DISTURBANCE
from towtank.recording.standard import MEASURED
from towtank.simulation import simulate
from towtank.vehicle import COEFFICIENTS, Posterior, Vehicle, configuration_matrix, index
from towtank.vehicle.matrices import damping_matrices
from towtank.vehicle.names import COLUMNS, KINDS, ROWS
from towtank.vehicle.posterior import DELAY, GAIN_PREFIX, LAG

__all__ = ["INSTRUMENTS", "RATE", "Forecast", "Instruments", "Outlook", "draws_of", "forecast", "quantity_of"]

RATE = 25.0  # Hz, of commands and rows of a forecast
_STEP = 0.05  # s, longest step of integration
_SUBSTEPS = 2


@dataclass(frozen=True)
class Instruments:
    """What is measured.

    Attributes:
        name: as `--sensors` takes it. summary: in words.
        channels: name to (rate [Hz], standard deviation) of the white noise, SI.
    """

    name: str
    summary: str
    channels: Mapping[str, tuple[float, float]]

    @cached_property
    def noise(self) -> Array:
        """Deviation (18,) of rows at `RATE` that tell as much as the instrument's own; 1 where there is none."""
        out = np.ones(len(MEASURED))
        for name, (rate, std) in self.channels.items():
            out[MEASURED.index(name)] = std * math.sqrt(max(RATE / rate, 1.0 / 25.0)) if rate > RATE else std
        return out

    def seen(self, motion: Array) -> Array:
        """Return rows (n, 18) of a motion (n, 12) [eta, nu] as they are measured, NaN where nothing is."""
        n = len(motion)
        out = np.full((n, len(MEASURED)), np.nan)
        for name, (rate, _) in self.channels.items():
            column, every = MEASURED.index(name), max(1, round(RATE / rate))
            out[::every, column] = motion[::every, column]
        return out


def _alike(names: str, rate: float, std: float) -> dict[str, tuple[float, float]]:
    return dict.fromkeys(names.split(), (rate, std))


INSTRUMENTS: dict[str, Instruments] = {
    each.name: each
    for each in (
        Instruments(
            "pose", "motion capture, 100 Hz", _alike("x y z", 100.0, 1e-3) | _alike("phi theta psi", 100.0, 1e-3)
        ),
        Instruments(
            "dvl",
            "DVL 5 Hz, attitude, gyro and depth",
            _alike("u v w", 5.0, 5e-3)
            | _alike("phi theta psi", 25.0, 5e-3)
            | _alike("p q r", 100.0, 2e-3)
            | _alike("z", 10.0, 0.01),
        ),
        Instruments("gyro-depth", "gyro and depth", _alike("p q r", 100.0, 2e-3) | _alike("z", 10.0, 0.01)),
    )
}


@dataclass(frozen=True, eq=False)
class Outlook:
    """What is known before a run.

    Attributes:
        vehicle: what is supposed. known: of all unknowns, with the covariance so far.
        instruments: what will be measured. disturbance: levels (6,) of the random force [m/s^2, rad/s^2], correlated
            over `correlation` [s].
    """

    vehicle: Vehicle
    known: Prior
    instruments: Instruments
    disturbance: tuple[float, ...] = DISTURBANCE
    correlation: float = 2.0

    @classmethod
    def of(cls, vehicle: Vehicle, sensors: str = "pose", *, force: float | None = None) -> Outlook:
        """Return what is known of a vehicle before any run.

        Args:
            sensors: one of `INSTRUMENTS`. force: random force [N] in place of the usual one; moments a tenth of it.

        Raises:
            InputError: other sensors; a vehicle without thrusters.
        """
        if sensors not in INSTRUMENTS:
            raise InputError(
                f'--sensors: found "{sensors}"{nearest(sensors, INSTRUMENTS)}; there are {", ".join(INSTRUMENTS)}'
            )
        if not vehicle.thrusters:
            raise InputError(f"{vehicle.name}: has no thrusters, expected a vehicle that can be driven")
        instruments = INSTRUMENTS[sensors]
        rows = instruments.seen(np.zeros((3, 12)))
        more = [name for name in further_unknowns([_samples(vehicle, rows, None)]) if name.startswith("latency")]
        levels = DISTURBANCE
        if force is not None:
            inertia = np.diag(vehicle.mass_matrix)
            levels = tuple((np.array([force] * 3 + [0.1 * force] * 3) / inertia).tolist())
        return cls(vehicle, prior_of(vehicle, more=more), instruments, levels)

    def after(self, covariance: Array) -> Outlook:
        """Return the outlook with another covariance (n, n) of the unknowns."""
        return replace(self, known=replace(self.known, covariance=covariance))


@dataclass(frozen=True, eq=False)
class Forecast:
    """What a run will make known.

    Attributes:
        t: (n,) [s]. eta, nu: of the drawn vehicle's motion (n, 6) without random force.
        names: of the unknowns. theta: their values (k,) in the coordinates of the prior, of the drawn vehicle.
        covariance: (k, k) of them at the end.
    """

    t: Array
    eta: Array
    nu: Array
    names: tuple[str, ...]
    theta: Array
    covariance: Array
    quantities: dict[str, float] = field(default_factory=dict)

    def relative(self, wanted: Sequence[str]) -> Array:
        """Return the deviations of coefficients as shares of their size; of an added mass as that of the inertia."""
        rows = [self.names.index(name) for name in wanted]
        std = np.sqrt(np.diag(self.covariance)[rows])
        return np.asarray(std / np.array([self.quantities[name] for name in wanted]))

    def information(self, wanted: Sequence[str]) -> float:
        """Return -log det of the covariance of the logarithms of the wanted: what is to be had, in nats, times two."""
        rows = [self.names.index(name) for name in wanted]
        scale = np.array([self.quantities[name] for name in wanted])
        block = self.covariance[np.ix_(rows, rows)] / np.outer(scale, scale)
        return -float(np.linalg.slogdet(block)[1])


def quantity_of(vehicle: Vehicle, name: str) -> float:
    """Return by what a deviation is divided: 1 of a logarithm (inertia, gain), else the size of the coefficient.

    That of a damping that is 0 is the other damping of its axis at 0.3 m/s or rad/s, so that it is small beside it.
    """
    if name not in COEFFICIENTS:
        return 1.0
    kind, i, j = index(name)
    if kind == "mass" and i == j:
        return 1.0
    value = abs(vehicle.coefficient(name))
    if value == 0.0 and kind in ("linear", "quadratic") and i == j:
        other = f"{ROWS[i]}_{COLUMNS[i] * (2 if kind == 'linear' else 1)}"
        value = abs(vehicle.coefficient(other)) * (0.3 if kind == "linear" else 1.0 / 0.3)
    return value if value > 0.0 else 1.0


def draws_of(outlook: Outlook, count: int, seed: int = 0) -> tuple[Vehicle, ...]:
    """Return vehicles drawn from what is known so far, `Vehicle.sample`; the first is the mean itself."""
    known = outlook.known
    signs = known.free.signs
    mean = np.where(signs < 0.0, known.free.rigid - known.mean, known.mean)
    kept = [k for k, name in enumerate(known.names) if not name.startswith("latency")]
    covariance = known.covariance * np.outer(signs, signs)
    posterior = Posterior.from_covariance(
        [known.names[k] for k in kept], mean[kept], covariance[np.ix_(kept, kept)], known.reference[kept]
    )
    base = outlook.vehicle.model_copy(update={"posterior": posterior})
    middle = outlook.vehicle.with_coefficients(known.vehicle_values)
    return tuple(_braked(each) for each in ((middle, *base.sample(count - 1, seed)) if count > 1 else (middle,)))


def _braked(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose damping takes energy out: couplings and what differs by direction are as drag allows."""
    changes = {}
    for name, each in vehicle.hydrodynamics.items():
        kind, i, _ = index(name)
        if (by := KINDS[kind].outweighed_by) is not None:
            most = abs(min(vehicle.coefficient(KINDS[by].name(i, i)), 0.0))
            changes[name] = float(np.clip(each.value, -most, most))
    couplings = [
        name for name in vehicle.hydrodynamics if index(name)[0] == "linear" and index(name)[1] != index(name)[2]
    ]
    for share in (1.0, 0.5, 0.25, 0.0):
        kept = {name: share * vehicle.coefficient(name) for name in couplings}
        L, _ = damping_matrices({name: each.value for name, each in vehicle.hydrodynamics.items()} | kept)
        if np.linalg.eigvalsh(-(L + L.T)).min() >= -1e-12 * np.abs(L).max():
            changes |= kept if share < 1.0 else {}
            break
    return vehicle.with_coefficients(changes) if changes else vehicle


def forecast(outlook: Outlook, truth: Vehicle, commands: Array, *, start: Array | None = None) -> Forecast:
    """Return what a run will make known, if the vehicle is `truth`.

    Args:
        truth: the drawn vehicle. commands: (n, m) at `RATE`, held. start: pose (6,), default the origin.

    Raises:
        InputError: the motion grows beyond all bounds.
    """
    run = simulate(truth, commands=commands, dt=1.0 / RATE, substeps=_SUBSTEPS, eta0=start)
    motion = np.column_stack([run[name].values for name in MEASURED[:12]])
    known, instruments = outlook.known, outlook.instruments
    theta = _theta(outlook, truth)
    samples = _samples(outlook.vehicle, instruments.seen(motion), commands)
    settings = replace(settings_for([samples], FilterSettings(step=_STEP)), time_constant=outlook.correlation)
    supposed = replace(known, mean=theta)
    problem = JointProblem((samples,), truth, supposed, settings, instruments.noise)
    levels = NoiseLevels(instruments.noise, np.array(outlook.disturbance))
    state, *_ = one_pass(problem, theta, levels, windows=1)
    covariance = coefficient_block(state).copy()
    quantities = {name: quantity_of(truth, name) for name in known.names}
    return Forecast(run["x"].t, motion[:, :6], motion[:, 6:], known.names, theta, covariance, quantities)


def _theta(outlook: Outlook, truth: Vehicle) -> Array:
    """Return the coordinates (n,) of a drawn vehicle."""
    nominal = {each.name: each for each in outlook.vehicle.thrusters}
    lag = max((each.time_constant for each in truth.thrusters), default=0.0)
    values = []
    for name, mean in zip(outlook.known.names, outlook.known.values, strict=True):
        if name in COEFFICIENTS:
            values.append(truth.coefficient(name))
        elif name.startswith(GAIN_PREFIX):
            thruster = name.removeprefix(GAIN_PREFIX)
            gain = next(each.gain for each in truth.thrusters if each.name == thruster)
            values.append(gain / nominal[thruster].gain)
        else:
            values.append({DELAY: truth.command_delay, LAG: lag}.get(name, float(mean)))
    return np.maximum(outlook.known.free.thetas(np.array(values)), outlook.known.free.bounds[0])


def _samples(vehicle: Vehicle, rows: Array, commands: Array | None) -> Samples:
    """Return rows (n, 18) at `RATE` with the inputs of commands (n - 1, m)."""
    m = len(vehicle.thrusters)
    force = np.zeros((1, m)) if commands is None else held_forces(vehicle, commands, None)
    kept = np.isfinite(rows).any(axis=1)
    t = np.arange(len(rows)) / RATE
    lag = np.array([each.time_constant for each in vehicle.thrusters])
    B = np.ascontiguousarray(configuration_matrix(vehicle))
    return Samples(t[kept], rows[kept], np.arange(len(force)) / RATE, force, B, lag, True)
