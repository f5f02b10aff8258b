"""What is asked of the joint filter, and what it answers; the states, inputs and latencies that samples call for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import ZeroOrderHold, new_zero_order_hold
from towtank.identification.data.samples import NoiseLevels, Samples
from towtank.identification.kalman.state import FilterSettings, JointState
from towtank.identification.model.measurements import shown_axes
from towtank.identification.model.parameters import IN_DELAY, IN_LAG, IN_LATENCY, FreeParameters
from towtank.identification.model.prior import Prior
from towtank.identification.model.terms import DISTURBANCE
from towtank.vehicle import Vehicle

__all__ = ["ROUGH", "JointFit", "JointProblem", "inputs_of", "latencies_of", "settings_for"]

ROUGH = 20.0  # times the usual disturbance, in the first pass


@dataclass(frozen=True, eq=False)
class JointProblem:
    """What is asked of the filter.

    Attributes:
        samples: of each recording. vehicle: with all that is fixed. prior: of all unknowns.
        settings: of the filter, `settings_for`. own_noise: (18,) that the samples show by themselves.
        delay, lag: of the inputs [s] where they are no unknowns; lag (m,).
        session: whether the samples are stretches of one session, on its clock: minutes later the water is the same.
        single: the question about each single sample, where the samples of this one are means (`in_steps`).
    """

    samples: Sequence[Samples]
    vehicle: Vehicle
    prior: Prior
    settings: FilterSettings
    own_noise: Array
    delay: float = 0.0
    session: bool = False
    single: JointProblem | None = None

    @property
    def free(self) -> FreeParameters:
        """The unknowns."""
        return self.prior.free

    @property
    def learned(self) -> NDArray[np.bool_]:
        """Which unknowns (n,) are learned: those of axes that move. Others count as what they may be."""
        return self.free.felt(self.moving)

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Axes (6,) whose motion a sensor shows, or inputs make: by more than what disturbs a vehicle anyway."""
        shown = shown_axes(np.any([each.measured for each in self.samples], axis=0))
        inertia = np.diag(self.vehicle.mass_matrix)
        pushed = [np.sqrt(np.mean((each.input_force @ each.B.T / inertia) ** 2, axis=0)) for each in self.samples]
        return np.asarray(shown | (np.max(pushed, axis=0) > np.array(DISTURBANCE)))

    @property
    def waving(self) -> NDArray[np.bool_]:
        """Axes (3,), NED, along which waves can show; along others they would be what is supposed of them."""
        return np.repeat([self.moving[:2].any(), self.moving[2]], [2, 1])

    @property
    def stiff(self) -> Array | None:
        """Theta (n,) of a stiff vehicle; None where it is measured how it leans, or somebody said how stiff it is.

        Gyros alone tell stiffness by what swings. Passes from too soft a vehicle end where inertia makes up for it.
        """
        about, unseen = self.prior.mean.copy(), not np.any([each.measured[3:5] for each in self.samples])
        stiff = np.array([name == "BG_z" for name in self.prior.names]) & (self.prior.std > np.abs(about)) & unseen
        return np.asarray(about + stiff * self.prior.std) if (stiff & self.learned).any() else None

    @property
    def usual(self) -> NoiseLevels:
        """Levels of a first pass where motion follows the data: the usual disturbance."""
        return NoiseLevels(self.own_noise, np.array(DISTURBANCE))

    @property
    def rough(self) -> NoiseLevels:
        """Levels of a first pass far off: a disturbance far larger than it will be, so that little is rejected."""
        return replace(self.usual, disturbance=ROUGH * self.usual.disturbance)

    def over(self, samples: Sequence[Samples]) -> JointProblem:
        """Return the same question about other samples."""
        return replace(self, samples=samples, single=None)

    def in_steps(self) -> JointProblem:
        """Return the question about the means of what each sensor shows within a step of integration.

        With an acceleration a over a step h, the mean of positions lies less than a h^2 / 8 off that at its time. Only
        where a sensor sees the ground: means of what accelerometers and gyros alone show have not been judged.
        """
        if not self.settings.current:
            return self
        means = [each.averaged(self.settings.step) for each in self.samples]
        before, after = (sum(np.isfinite(each.values).sum(axis=0) for each in some) for some in (self.samples, means))
        quieter = np.sqrt(after / np.maximum(before, 1))
        return replace(self, samples=means, own_noise=np.where(before, quieter, 1.0) * self.own_noise, single=self)

    def between_looks(self) -> JointProblem:
        """Return the question where inputs go on between two looks at them; itself where that makes no difference."""
        samples = [each.between_looks() for each in self.samples]
        if all(a is b for a, b in zip(samples, self.samples, strict=True)):
            return self
        return replace(self, samples=samples, single=self.single and self.single.between_looks())

    @property
    def of_each(self) -> JointProblem:
        """The question about each single sample."""
        return self.single or self

    @property
    def quieter(self) -> Array:
        """Noise of these samples as a share (18,) of that of single ones."""
        return self.own_noise / self.of_each.own_noise


@dataclass(frozen=True, eq=False)
class JointFit:
    """The posterior, and how it was found.

    Attributes:
        prior: what was supposed. mean, covariance: (n,) and (n, n) of the Gaussian, in the coordinates of its `free`.
        theta: the likeliest of it (n,) that physics allows.
        wider: factors (n,) to the deviations that the filter itself states, by what windows disagree about.
        forbidden: by how much likelier [log] data and prior are at `mean`, where physics forbids that, than at `theta`.
        disagreement: factor by which windows of the data differ more than they state, 1 at least; the covariance is
            widened by it, see `widened`.
        levels: as the data show them. wave_period: [s], where the levels have waves.
        likelihood: log, of the last pass's innovations. passes: how many were run.
        rejected: share of each column's samples that lay beyond the gate (18,).
        state: of the filter at the end of the last pass. still: whether that moved nothing any more.
    """

    prior: Prior
    mean: Array
    theta: Array
    covariance: Array
    wider: Array
    forbidden: float
    disagreement: float
    levels: NoiseLevels
    wave_period: float
    likelihood: float
    passes: int
    rejected: Array
    state: JointState
    still: bool = False

    @property
    def free(self) -> FreeParameters:
        """The unknowns."""
        return self.prior.free

    @property
    def std(self) -> Array:
        """Deviations of theta (n,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


def settings_for(samples: Sequence[Samples], settings: FilterSettings) -> FilterSettings:
    """Return the settings with the states that these samples' sensors need.

    Biases where there is an inertial sensor; an attitude that wanders where no camera measures it together with the
    position; a current where position or speed over ground is measured.
    """
    measured = np.any([each.measured for each in samples], axis=0)
    inertial = bool(measured[9:12].any() or measured[12:15].any())
    camera = bool(measured[:6].all())
    over_ground = bool((measured[:3].any() or measured[6:9].any()) and measured[5])
    return replace(settings, biases=inertial, wanders=inertial and not camera, current=over_ground)


def inputs_of(samples: Samples, free: FreeParameters, theta: Array, delay: float) -> ZeroOrderHold:
    """Return the inputs of a recording with the delay and lag of theta."""
    lag = samples.lag
    for k in range(len(free)):
        if free.codes[k, 0] == IN_DELAY:
            delay = max(0.0, float(theta[k]))
        elif free.codes[k, 0] == IN_LAG:
            lag = np.full(samples.lag.size, float(theta[k]))
    return new_zero_order_hold(samples.B.shape[1], lag, delay)


def latencies_of(free: FreeParameters, theta: Array) -> Array:
    """Return the latency (6,) [s] of each sensor at theta (n,), 0 where it is no unknown."""
    out, late = np.zeros(6), free.codes[:, 0] == IN_LATENCY
    out[free.codes[late, 1]] = theta[late]
    return out
