"""The paper's method on recordings as wholes: the delay, least squares, then instruments driven by the commands alone.

Each pass is the streaming kernel's own, over all recordings; structure and couplings follow between passes.

The delay between a command and its force is the one that explains the recordings best. Every delay costs one pass of
least squares with all columns and a fast filter (slow ones let disturbances answer for the commands and pull the delay
to zero). The criterion is -2 ln L = sum n ln(SSE) over the axes; a parabola through its least three values gives the
delay between the steps. Residuals are alike over seconds where disturbances are slow, so the deviation comes from the
long-run variance of the criterion's slope over blocks of time, not from its curvature alone.

Least squares takes whatever moves with the motion for an effect of the motion; on real logs slow disturbances answer
to the speed and inflate the inertia. A second set of regressors, simulated from the commands with the coefficients
found so far, knows nothing of the disturbance: with these as instruments the bias is gone, and the result hardly
depends on the filter constant (the refined instrumental variable method; Young, Recursive Estimation and Time-Series
Analysis, 2011).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Unpack

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.data.samples import Sources, prepared
from towtank.identification.least_squares.chain import PaperChain, Settings, Tuning, uses_commands
from towtank.identification.least_squares.solution import (
    AxisFindings,
    AxisInformation,
    AxisSolution,
    absent,
    estimate_of,
    merge_information,
    select,
    solve_axis,
)
from towtank.identification.model.terms import AXES, C_LINEAR, C_MASS, C_QUADRATIC, Candidates, candidates
from towtank.identification.posterior.assembly import DelayScan, LogLearning
from towtank.identification.posterior.estimate import Estimate, with_shift
from towtank.identification.posterior.statistics import long_run
from towtank.recording import Grid, Recording, align
from towtank.recording.grids.stretches import spread
from towtank.vehicle import Vehicle

__all__ = ["DelayCost", "Progress", "estimate_warnings", "learn_paper", "scan_delay"]

_COARSE, _FINE = 0.02, 0.005  # s, steps of the delay
_LAGS = 8  # blocks over which slopes are taken to be alike
_Family = tuple[bool, bool]  # linear, quadratic damping free
_FAMILIES: tuple[_Family, ...] = ((True, True), (True, False), (False, True))
_ITERATIONS = 2  # passes with instruments, each driven by what the last one found
_ACTIVE = 0.1  # of the largest spread of commands among the recordings, for a recording to count on an axis
_QUADRATIC_MUST_GAIN = 0.9  # misfit of quadratic damping alone over that of others, to be taken
_SCAN_FILTER = 40.0  # 1/s, where velocities are measured;
_SCAN_DERIVED = 10.0  # 1/s, where they are low-passed: above the corner there is noise alone
_SCAN_SECONDS = 600.0  # s of each recording that the scan goes over
_SCAN_BLUR = 0.0025  # s, of a delay found through low-passed velocities: what 30 simulated sessions showed
_ROUNDS = 12  # at most; each with the couplings of what the last one learned
_SETTLED = 0.1  # deviations, or a thousandth of its value, that nothing may move any more
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class DelayCost:
    """-2 ln L of one delay, and its parts (b,) over blocks of time for every axis."""

    value: float
    blocks: Sequence[Array] = field(default=())


def scan_delay(cost: Callable[[float], DelayCost], longest: float) -> DelayScan:
    """Return the delay in [0, longest] [s] of least cost.

    Args:
        cost: of the recordings for a delay [s].
        longest: end of the range scanned [s].
    """
    found: dict[float, DelayCost] = {}

    def at(delay: float) -> DelayCost:
        key = round(float(delay), 6)
        if key not in found:
            found[key] = cost(key)
        return found[key]

    coarse = np.arange(0.0, longest + 0.5 * _COARSE, _COARSE)
    best = coarse[int(np.argmin([at(d).value for d in coarse]))]
    fine = np.arange(max(0.0, best - _COARSE), min(longest, best + _COARSE) + 0.5 * _FINE, _FINE)
    values = np.array([at(d).value for d in fine])
    i = int(values.argmin())
    delays = np.array(sorted(found))
    costs = np.array([found[d].value for d in delays])
    if len(fine) < 3:
        return DelayScan(float(fine[i]), float("nan"), delays, costs)
    centre = min(max(i, 1), len(fine) - 2)
    low, mid, high = values[centre - 1], values[centre], values[centre + 1]
    bend = low - 2.0 * mid + high
    if not bend > 0.0:
        return DelayScan(float(fine[i]), float("nan"), delays, costs)
    delay = float(fine[i])
    if i == centre:
        delay += 0.5 * _FINE * (low - high) / bend
    std = _deviation(at(fine[centre - 1]).blocks, at(fine[centre + 1]).blocks, bend / _FINE**2)
    return DelayScan(float(delay), std, delays, costs)


def _deviation(before: Sequence[Array], after: Sequence[Array], curvature: float) -> float:
    """Return the deviation [s] of the delay from the slopes' long-run variance and the criterion's curvature."""
    if not before:
        return float("nan")
    variance = 0.0
    for low, high in zip(before, after, strict=True):
        slope = (high - low) / (2.0 * _FINE)
        slope = slope[slope != 0.0]
        if len(slope) > 4:
            variance += float(long_run((slope - slope.mean())[:, None], _LAGS)[0, 0])
    return float(np.sqrt(variance) / curvature)


@dataclass(frozen=True)
class Gathered:
    """What one pass over the recordings gathered.

    Attributes:
        informations: of each axis, None where it is not measured.
        misfit: (6,) integral of the instruments' squared distance from the measured velocity.
        duration: time learned from [s]. rows: samples learned from.
    """

    informations: Sequence[AxisInformation | None]
    misfit: Array
    duration: float
    rows: int


class Passes:
    """Passes of the chain over a set of recordings."""

    def __init__(
        self, vehicle: Vehicle, grids: Sequence[Grid], settings: Settings, to_learn: Sequence[Candidates]
    ) -> None:
        self.vehicle, self.grids, self.settings, self.candidates = vehicle, tuple(grids), settings, tuple(to_learn)
        self.sources = [sources_of(grid) for grid in grids]
        self.commands = [uses_commands(vehicle, grid) for grid in grids]
        for grid, commands in zip(grids, self.commands, strict=True):
            if not commands and not grid.wrench_t.size:
                raise InputError(
                    f"{grid.source or 'recording'}: neither thruster commands nor a wrench is recorded, so there is "
                    "nothing to learn from; map the thrusters' columns (--map) or record X Y Z K M N"
                )
        self.active = self._active()

    def _chain(
        self, index: int, vehicle: Vehicle, settings: Settings, known: Array, free: Array, driven: Array | None = None
    ) -> PaperChain:
        """Return a fresh chain for one recording."""
        commands = self.commands[index]
        return PaperChain(vehicle, self.sources[index], settings, free, known, commands=commands, driven=driven)

    def _active(self) -> list[list[int]]:
        """Return, per axis, the recordings whose commands move it."""
        spread = []
        for index, grid in enumerate(self.grids):
            chain = self._chain(index, self.vehicle, self.settings, *self._structure(None))
            values = grid.command_values if self.commands[index] else grid.wrench_values
            wrench = chain.forces(np.array(values)) @ chain.state.shape.T
            finite = wrench[np.isfinite(wrench).all(axis=1)]
            spread.append(finite.std(axis=0) if len(finite) else np.zeros(6))
        table = np.array(spread)
        least = _ACTIVE * table.max(axis=0)
        chosen = []
        for i in range(6):
            measured = [k for k in range(len(self.grids)) if self.sources[k].velocity[i] != "absent"]
            excited = [k for k in measured if table[k, i] >= least[i] and table[k, i] > 0.0]
            chosen.append(excited or measured)
        return chosen

    def _structure(self, family: _Family | None) -> tuple[Array, Array]:
        """Return known values and free flags (6, 5) for one family of damping terms; None: as requested."""
        known = np.array([candidate.known for candidate in self.candidates])
        free = np.array([candidate.to_learn for candidate in self.candidates], dtype=np.float64)
        if family is not None:
            for c, flag in enumerate(family):
                dropped = (free[:, c] > 0.0) & (not flag)
                known[dropped, c] = 0.0
                free[dropped, c] = 0.0
        return known, free

    def find_delay(self, longest: float, progress: Progress) -> DelayScan:
        """Scan the delay by least squares with a fast filter."""
        known, free = self._structure(None)
        free[:, :4] = [[1.0, 1.0, float(bool(axis.restoring)), float(axis.index != 2)] for axis in AXES]
        derived = any("derived" in sources.velocity for sources in self.sources)
        fast = replace(self.settings, a=_SCAN_DERIVED if derived else _SCAN_FILTER)
        cut = [grid.stretch(0, int(np.searchsorted(grid.t, grid.t[0] + _SCAN_SECONDS))) for grid in self.grids]
        tried = 0

        def cost(delay: float) -> DelayCost:
            nonlocal tried
            tried += 1
            progress("delay", 0.05 + 0.35 * min(1.0, tried / 30.0))
            gathered = self._gather(self.vehicle, replace(fast, delay=delay), known, free, grids=cut)
            total = 0.0
            blocks: list[Array] = []
            for i, information in enumerate(gathered.informations):
                solution = None if information is None else _solve_or_simpler(information, free[i], known[i])
                if solution is not None and solution.residual_sum > 0.0:
                    total += solution.rows * np.log(solution.residual_sum)
                    blocks.append(solution.rows / solution.residual_sum * solution.block_residuals)
            return DelayCost(total, blocks)

        scan = scan_delay(cost, longest)
        return replace(scan, std=float(np.hypot(scan.std, _SCAN_BLUR))) if derived else scan

    def _gather(
        self,
        vehicle: Vehicle,
        settings: Settings,
        known: Array,
        free: Array,
        *,
        driven: Array | None = None,
        grids: Sequence[Grid] | None = None,
    ) -> Gathered:
        """Run all recordings once, with instruments where there is something to drive them."""
        chains = []
        for index, grid in enumerate(grids or self.grids):
            chains.append(self._chain(index, vehicle, settings, known, free, driven))
            chains[-1].run(grid)
        informations: list[AxisInformation | None] = []
        misfit = np.zeros(6)
        for i in range(6):
            used = [chains[k] for k in self.active[i]]
            informations.append(merge_information([chain.information(i) for chain in used]) if used else None)
            misfit[i] = sum(float(chain.state.instruments.squared_error[i]) for chain in used)
        duration, rows = sum(chain.duration for chain in chains), sum(chain.rows for chain in chains)
        return Gathered(informations, misfit, duration, rows)

    def least_squares(self, model: Vehicle | None = None) -> Estimate:
        """Learn by least squares with the couplings of `model`; where omitted they are learned along the way."""
        known, free = self._structure(None)
        settings = replace(self.settings, learn_model=model is None)
        gathered = self._gather(model or self.vehicle, settings, known, free)
        findings = [self._by_least_squares(c, gathered.informations[c.axis.index]) for c in self.candidates]
        return estimate_of(self.vehicle, findings, gathered.duration, gathered.rows)

    def _by_least_squares(self, candidate: Candidates, information: AxisInformation | None) -> AxisFindings:
        if information is None:
            return absent(candidate, _not_measured(candidate))
        return select(
            candidate,
            lambda flags, known: solve_axis(information, flags, known),
            lambda solution: solution.residual_sum,
            commanded=information.commanded_share,
        )

    def with_instruments(self, model: Vehicle) -> Estimate:
        """Learn with command-driven instruments, every family of damping terms with its own."""
        families: dict[_Family, Gathered] = {}
        settings = replace(self.settings, learn_model=False)
        for family in _FAMILIES:
            known, free = self._structure(family)
            gathered = self._gather(model, settings, known, free)
            for k in range(_ITERATIONS):
                driven = _driven(gathered.informations, known, free, instruments=k > 0)
                gathered = self._gather(model, settings, known, free, driven=driven)
            families[family] = gathered
        findings = [_by_instruments(candidate, families) for candidate in self.candidates]
        return estimate_of(self.vehicle, findings, gathered.duration, gathered.rows)


def _solve_or_simpler(
    information: AxisInformation, free: Array, known: Array, *, instruments: bool = False
) -> AxisSolution | None:
    """Solve one axis with its free columns, or without restoring and constant where these cannot be told."""
    flags = tuple(bool(flag) for flag in free)
    solution = solve_axis(information, flags, known, instruments=instruments)
    if solution is None:
        solution = solve_axis(information, (*flags[:2], False, False, True), known, instruments=instruments)
    return solution


def _driven(
    informations: Sequence[AxisInformation | None], known: Array, free: Array, *, instruments: bool = False
) -> Array:
    """Return the coefficients (6, 5) that drive the instruments; mass 0 where an axis has none."""
    out = np.zeros((6, 5))
    for i, information in enumerate(informations):
        if information is None or not free[i, C_MASS]:
            continue
        solution = _solve_or_simpler(information, free[i], known[i], instruments=instruments)
        if solution is None or not solution.values[C_MASS] > 0.0:
            continue
        values = solution.values.copy()
        values[:2] = np.minimum(values[:2], 0.0)
        if not values[:2].any():
            values[C_LINEAR] = -values[C_MASS]
        out[i] = values
    return out


def _by_instruments(candidate: Candidates, families: dict[_Family, Gathered]) -> AxisFindings:
    i = candidate.axis.index
    first = families[_FAMILIES[0]].informations[i]
    if first is None:
        return absent(candidate, _not_measured(candidate))

    def family(flags: Sequence[bool]) -> Gathered:
        both = (bool(flags[C_LINEAR]), bool(flags[C_QUADRATIC]))
        return families[both if both in families else _FAMILIES[0]]

    def solve(flags: tuple[bool, ...], known: Array) -> AxisSolution | None:
        information = family(flags).informations[i]
        return None if information is None else solve_axis(information, flags, known, instruments=flags[C_MASS])

    def cost(solution: AxisSolution) -> float:
        misfit = float(family(solution.free).misfit[i])
        return misfit / _QUADRATIC_MUST_GAIN if solution.free[C_QUADRATIC] and not solution.free[C_LINEAR] else misfit

    return select(candidate, solve, cost, commanded=first.commanded_share)


def _not_measured(candidate: Candidates) -> str:
    axis = candidate.axis
    return f"{axis.name} speed {axis.velocity} is not measured in these recordings"


def sources_of(grid: Grid) -> Sources:
    """Return where the velocities and the attitude of a grid come from."""
    return Sources.of(grid.pose, grid.velocity, grid.acceleration)


def learn_paper(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    *,
    free: Collection[str] | None = None,
    delay: float | None = None,
    longest_delay: float = 0.4,
    instruments: bool = True,
    sparing: bool = False,
    progress: Progress | None = None,
    **tuning: Unpack[Tuning],
) -> LogLearning:
    """Learn a vehicle's coefficients from one or several recordings by the paper's method.

    Args:
        free: names of the coefficients to learn, see `Learner`.
        delay: from command (or recorded wrench) to force [s]; found by scanning up to `longest_delay` where omitted.
        instruments: remove the bias of least squares with command-driven instruments.
        sparing: of long recordings learn from stretches, evenly spread.
        progress: called with a text and the share done, 0 .. 1.
        tuning: a, lowpass and others of `Settings`.

    Raises:
        InputError: no recording, no motion, no commands, thrusters that the vehicle lacks, an unknown name.
    """
    if not recordings:
        raise InputError("no recording given, expected at least one")
    if not 0.0 <= longest_delay < 10.0:
        raise InputError(f"longest_delay: found {longest_delay}, expected seconds between 0 and 10")
    report = progress or (lambda text, share: None)
    report("aligning", 0.0)
    grids = tuple(align(prepared(recording, vehicle)) for recording in recordings)
    used = tuple(spread(grids)) if sparing else grids
    passes = Passes(vehicle, used, Settings(delay=delay or 0.0, **tuning), candidates(vehicle, free))
    scan = None
    if delay is None:
        report("delay", 0.05)
        scan = passes.find_delay(longest_delay, report)
        passes = Passes(vehicle, used, replace(passes.settings, delay=scan.delay), passes.candidates)
    report("least squares", 0.4)
    estimate = passes.least_squares()
    for _ in range(_ROUNDS):
        last, estimate = estimate, passes.least_squares(estimate.model(vehicle))
        if _settled(last, estimate):
            break
    for round_ in range(_ROUNDS if instruments else 0):
        report("instruments", 0.5 + 0.4 * round_ / _ROUNDS)
        last, estimate = estimate, passes.with_instruments(estimate.model(vehicle))
        if _settled(last, estimate):
            break
    if instruments and scan is not None and np.isfinite(scan.std):
        report("deviations", 0.95)
        late = Passes(vehicle, used, replace(passes.settings, delay=scan.delay + scan.std), passes.candidates)
        estimate = with_shift(estimate, late.with_instruments(estimate.model(vehicle)))
    report("done", 1.0)
    model = estimate.model(vehicle, "learned by towtank, method paper")
    if any(passes.commands):
        model = model.model_copy(update={"command_delay": passes.settings.delay})
    warnings = _warnings(vehicle, estimate, scan, longest_delay, grids)
    sources = tuple(map(sources_of, grids))
    given = delay is not None
    return LogLearning(
        vehicle, estimate, model, passes.settings.delay, scan, grids, sources, warnings, delay_given=given
    )


def _settled(last: Estimate, new: Estimate) -> bool:
    """Whether nothing moved any more from one round to the next."""
    if last.identified != new.identified:
        return False
    known = np.array(new.identified, dtype=np.bool_)
    step = np.abs(new.values - last.values)[known]
    return bool(np.all(step <= np.maximum(_SETTLED * new.std[known], 1e-3 * np.abs(new.values[known]))))


def _warnings(
    vehicle: Vehicle, estimate: Estimate, scan: DelayScan | None, longest: float, grids: Sequence[Grid]
) -> tuple[str, ...]:
    out: list[str] = []
    if scan is not None and scan.at_limit:
        out.append(f"the delay reached the end of the range scanned ({longest:g} s); it may be longer")
    for grid in grids:
        if grid.repairs:
            out.append(f"{grid.source or 'recording'}: {grid.repairs.summary}")
    return (*out, *estimate_warnings(vehicle, estimate))


def estimate_warnings(vehicle: Vehicle, estimate: Estimate) -> tuple[str, ...]:
    """Return what is odd about an estimate: nothing identified, an inertia less than the rigid body's own."""
    out: list[str] = []
    if not any(estimate.identified):
        out.append("nothing could be identified in these recordings; `towtank inspect` says what each axis lacks")
    lowest = vehicle.rigid_body_matrix
    for axis in AXES:
        name = axis.added_mass
        if name in estimate and estimate[name].identified and estimate[name].value > 2.0 * estimate[name].std:
            total = float(lowest[axis.index, axis.index]) - estimate[name].value
            out.append(
                f"{axis.sum_name} is {total:.3g} {axis.unit}, less than the rigid body's own "
                f"{lowest[axis.index, axis.index]:.3g}: check the vehicle's mass and the thrusters' force scale"
            )
    return tuple(out)
