"""One stretch of samples through the paper's chain: which sources feed it, and the loop over a grid or a stream."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import ZeroOrderHold, new_zero_order_hold
from towtank.errors import InputError
from towtank.identification.data.samples import Sources, with_absent_zero
from towtank.identification.least_squares.forgetting import directional_information
from towtank.identification.least_squares.recursion import paper_events
from towtank.identification.least_squares.rls import Scheme, require_scheme
from towtank.identification.least_squares.solution import AxisInformation
from towtank.identification.least_squares.state import PaperState, RecursionSettings, new_paper_state
from towtank.identification.least_squares.velocity import ATTITUDES, VELOCITIES, Motion, MotionRows, new_motion, rows_of
from towtank.recording import Grid
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

__all__ = ["PaperChain", "Settings", "Tuning", "uses_commands"]

_LOWPASSED = 0.003  # relative error left by low-passing the motion before squaring it


class Tuning(TypedDict, total=False):
    """Settings of the paper's chain that a caller may give by name; see `Settings`."""

    a: float
    lowpass: float
    gap: float
    forgetting: float
    scheme: Scheme


@dataclass(frozen=True)
class Settings:
    """Settings of the paper's chain; the defaults suit a vehicle of 5 to 500 kg.

    Attributes:
        a: filter constant of both sides [1/s]. Small values average measurement noise away, large ones slow
            disturbances.
        lowpass: corner of the low-pass where velocity is derived from the pose [Hz].
        delay: from the command to the thruster [s].
        gap: longest step between samples that is integrated over [s].
        forgetting: factor per sample, 1 never forgets.
        smooth: inputs are samples of a smooth function, not held commands.
        scheme: what is forgotten, see `RecursiveLeastSquares`.
        learn_model: couplings and end corrections use what was learned so far, not the vehicle's coefficients alone.

    Raises:
        InputError: a setting is out of range.
    """

    a: float = 3.0
    lowpass: float = 4.0
    delay: float = 0.0
    gap: float = 0.5
    forgetting: float = 1.0
    smooth: bool = False
    scheme: Scheme = "directional"
    learn_model: bool = True

    def __post_init__(self) -> None:
        for name in ("a", "lowpass", "gap"):
            value = getattr(self, name)
            if not 0.0 < value < np.inf:
                raise InputError(f"{name}: found {value}, expected a positive number")
        if not 0.0 <= self.delay < np.inf:
            raise InputError(f"delay: found {self.delay}, expected a number of seconds, 0 or more")
        if not 0.0 < self.forgetting <= 1.0:
            raise InputError(f"forgetting: found {self.forgetting}, expected a factor in (0, 1]")
        require_scheme(self.scheme)


def uses_commands(vehicle: Vehicle, grid: Grid) -> bool:
    """Whether the wrench comes from the thrusters' commands; else it was recorded itself."""
    commands = grid.command_values
    return bool(vehicle.thrusters) and commands.shape[1] == len(vehicle.thrusters) and commands.size > 0


class PaperChain:
    """The recursion for one vehicle, one set of sources, and inputs of one kind.

    Args:
        free, known: (6, 5) see `PaperState`.
        commands: inputs are the thrusters' commands, not the wrench.
        driven: coefficients (6, 5) that drive instruments, see `Instruments`; None for plain least squares.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        sources: Sources,
        settings: Settings,
        free: Array,
        known: Array,
        *,
        commands: bool,
        driven: Array | None = None,
    ) -> None:
        if commands:
            shape = configuration_matrix(vehicle)
            lag = np.array([thruster.time_constant for thruster in vehicle.thrusters])
        else:
            shape, lag = np.eye(6), np.zeros(6)
        self.vehicle = vehicle
        self.sources = sources
        self.settings = settings
        self.commands = commands
        own = RecursionSettings(
            a=float(settings.a),
            forgetting=float(settings.forgetting),
            directional=settings.scheme == "directional",
            learn_model=settings.learn_model,
            instruments=driven is not None,
            smooth=settings.smooth,
        )
        coefficients = np.zeros((6, 5)) if driven is None else driven
        self.state: PaperState = new_paper_state(vehicle.parameters, free, known, shape, own, coefficients)
        self.motion: Motion = new_motion(
            np.array([VELOCITIES[kind] for kind in sources.velocity]),
            ATTITUDES[sources.attitude],
            2.0 * np.pi * settings.lowpass,
            settings.gap,
        )
        self.held: ZeroOrderHold = new_zero_order_hold(shape.shape[1], lag, settings.delay)
        self._no_command = np.full(shape.shape[1], np.nan)

    def restart(self) -> None:
        """Begin a new stretch whose times owe nothing to the last one's; what was learned stays."""
        self.motion.last.t[0] = np.nan
        self.motion.seen[:] = np.nan
        self.held.clock[0] = np.nan
        self.held.counters[:] = 0.0
        self.state.pending[:] = 0.0

    def forces(self, commands: Array, voltage: Array | None = None) -> Array:
        """Steady force of each held input (..., m) of commands (..., n), or the wrench itself (..., 6).

        A component of the wrench that was never recorded is taken as zero.
        """
        if not self.commands:
            return with_absent_zero(commands)
        if voltage is not None and not np.isfinite(voltage).any():
            voltage = None
        return np.ascontiguousarray(thruster_forces(self.vehicle, commands, voltage))

    def step(self, t: float, pose: Array, velocity: Array, acceleration: Array, forces: Array | None) -> float:
        """Take one sample; return the length [s] of the interval learned from, 0 where none was."""
        asked = (self._no_command if forces is None else forces)[None]
        row = MotionRows(np.array([t]), pose[None], velocity[None], acceleration[None])
        for each in row:
            each.flags.writeable = False  # as in a grid: one type, one compilation
        return paper_events(self.state, self.motion, self.held, row, row.t[:0], asked[:0], asked)[1]

    def run(self, grid: Grid) -> int:
        """Take a whole grid, sample by sample; return how many intervals were learned from."""
        if self.commands:
            stamps, values = grid.command_t, grid.command_values
            voltage = np.interp(stamps, grid.t, grid.voltage) if np.isfinite(grid.voltage).any() else None
        else:
            stamps, values, voltage = grid.wrench_t, grid.wrench_values, None
        forces = self.forces(np.array(values), voltage)
        return paper_events(self.state, self.motion, self.held, rows_of(grid), stamps, forces, forces[:0])[0]

    def information(self, axis: int) -> AxisInformation:
        """What has been gathered on one axis (a view by copy)."""
        state, clock = self.state, self.state.clock
        filled = int(clock.block[0]) + 1
        triangle, blocks, rows = state.triangle[axis], state.blocks[axis], float(clock.rows_left[0])
        if self.settings.forgetting < 1.0 and self.settings.scheme == "directional":
            triangle, blocks, rows = directional_information(state, axis)
        return AxisInformation(
            triangle=np.triu(triangle.reshape(6, 6)),
            blocks=blocks[:filled].reshape(filled, 6, 6).copy(),
            block_length=float(clock.block_length[0]),
            rows=rows,
            a=self.settings.a,
            commanded=float(state.commanded[axis]),
            forced=float(state.forced[axis]),
            systematic=_LOWPASSED if "derived" in self.sources.velocity else 0.0,
        )

    @property
    def duration(self) -> float:
        """Time learned from [s]."""
        return float(self.state.clock.learned[0])

    @property
    def rows(self) -> int:
        """Samples learned from."""
        return int(self.state.clock.rows[0])
