"""Passes of the paper's chain over a set of recordings: for the delay, for least squares, with instruments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.axes import AXES
from towtank.identification.axis_solution import AxisInformation, AxisSolution, merge_information, solve_axis
from towtank.identification.chain import PaperChain, Settings, Sources, uses_commands
from towtank.identification.delay import DelayCost, DelayScan, scan_delay
from towtank.identification.estimate import Estimate, estimate_of
from towtank.identification.samples import INPUTS_BEFORE
from towtank.identification.stretches import spread_places
from towtank.identification.structure import AxisFindings, Candidates, absent, select
from towtank.recording import Grid
from towtank.vehicle import Vehicle

__all__ = ["Passes", "Progress", "sources_of", "spread_grids"]

_Family = tuple[bool, bool]  # linear, quadratic damping free
_FAMILIES: tuple[_Family, ...] = ((True, True), (True, False), (False, True))
_ITERATIONS = 2
_ACTIVE = 0.1  # of the liveliest recording's command, for a recording to count on an axis
_QUADRATIC_MUST_GAIN = 0.9
_SCAN_FILTER = 40.0  # 1/s, where velocities are measured;
_SCAN_DERIVED = 10.0  # 1/s, where they are low-passed: above the corner there is noise alone
_SCAN_SECONDS = 600.0
_SCAN_BLUR = 0.0025  # s, of a delay found through low-passed velocities: what 30 simulated sessions showed

Progress = Callable[[str, float], None]


class Passes:
    """Passes of the chain over a set of recordings."""

    def __init__(
        self, vehicle: Vehicle, grids: Sequence[Grid], settings: Settings, wanted: Sequence[Candidates]
    ) -> None:
        self.vehicle, self.grids, self.settings, self.candidates = vehicle, tuple(grids), settings, tuple(wanted)
        self.sources = [sources_of(grid) for grid in grids]
        self.commands = [uses_commands(vehicle, grid) for grid in grids]
        for grid, commands in zip(grids, self.commands, strict=True):
            if not commands and not grid.wrench_t.size:
                raise InputError(
                    f"{grid.source or 'recording'}: neither thruster commands nor a wrench is recorded, so there is "
                    "nothing to learn from; map the thrusters' columns (--map) or record X Y Z K M N"
                )
        self.duration = 0.0
        self.rows = 0
        self.active = self._active()

    def chain(self, index: int, vehicle: Vehicle, settings: Settings, known: Array, free: Array) -> PaperChain:
        """Return a fresh chain for one recording."""
        return PaperChain(vehicle, self.sources[index], settings, free, known, commands=self.commands[index])

    def _active(self) -> list[list[int]]:
        """Return, per axis, the recordings whose commands move it."""
        spread = []
        for index, grid in enumerate(self.grids):
            chain = self.chain(index, self.vehicle, self.settings, *self._structure(None))
            values = grid.command_values if self.commands[index] else grid.wrench_values
            wrench = chain.forces(np.array(values)) @ chain.state.shape.T
            finite = wrench[np.isfinite(wrench).all(axis=1)]
            spread.append(finite.std(axis=0) if len(finite) else np.zeros(6))
        table = np.array(spread)
        least = _ACTIVE * table.max(axis=0)
        chosen = []
        for i in range(6):
            measured = [k for k in range(len(self.grids)) if self.sources[k].velocity[i] != "absent"]
            lively = [k for k in measured if table[k, i] >= least[i] and table[k, i] > 0.0]
            chosen.append(lively or measured)
        return chosen

    def _structure(self, family: _Family | None) -> tuple[Array, Array]:
        """Return known values and free flags (6, 5) for one family of damping terms; None: as wanted."""
        known = np.array([candidate.known for candidate in self.candidates])
        free = np.array([candidate.wanted for candidate in self.candidates], dtype=np.float64)
        if family is not None:
            for c, flag in enumerate(family):
                dropped = (free[:, c] > 0.0) & (not flag)
                known[dropped, c] = 0.0
                free[dropped, c] = 0.0
        return known, free

    def find_delay(self, longest: float, told: Progress) -> DelayScan:
        """Scan the delay by least squares with a fast filter."""
        known, free = self._structure(None)
        free[:, :4] = [[1.0, 1.0, float(bool(axis.restoring)), float(axis.index != 2)] for axis in AXES]
        derived = any("derived" in sources.velocity for sources in self.sources)
        fast = replace(self.settings, a=_SCAN_DERIVED if derived else _SCAN_FILTER)
        cut = [_head(grid, _SCAN_SECONDS) for grid in self.grids]
        tried = 0

        def cost(delay: float) -> DelayCost:
            nonlocal tried
            tried += 1
            told("delay", 0.05 + 0.35 * min(1.0, tried / 30.0))
            informations = self._informations(self.vehicle, replace(fast, delay=delay), known, free, grids=cut)
            total = 0.0
            blocks: list[Array] = []
            for axis in AXES:
                information = informations[axis.index]
                if information is None:
                    continue
                flags = tuple(bool(flag) for flag in free[axis.index])
                solution = solve_axis(information, flags, known[axis.index])
                if solution is None:
                    solution = solve_axis(information, (*flags[:2], False, False, True), known[axis.index])
                if solution is not None and solution.residual_sum > 0.0:
                    total += solution.rows * np.log(solution.residual_sum)
                    blocks.append(solution.rows / solution.residual_sum * solution.block_residuals)
            return DelayCost(total, blocks)

        scan = scan_delay(cost, longest)
        return replace(scan, std=float(np.hypot(scan.std, _SCAN_BLUR))) if derived else scan

    def _informations(
        self,
        vehicle: Vehicle,
        settings: Settings,
        known: Array,
        free: Array,
        *,
        driven: Array | None = None,
        learn: bool = True,
        grids: Sequence[Grid] | None = None,
        errors: Array | None = None,
    ) -> list[AxisInformation | None]:
        """Run all recordings once; return the merged information of each axis, None where it is not measured."""
        chains = []
        for index, grid in enumerate(grids or self.grids):
            chain = self.chain(index, vehicle, settings, known, free)
            chain.state.settings[2] = float(learn)
            if driven is not None:
                chain.state.settings[3] = 1.0
                chain.state.driven[:] = driven
            chain.run(grid)
            chains.append(chain)
        self.duration = sum(chain.duration for chain in chains)
        self.rows = sum(chain.rows for chain in chains)
        out: list[AxisInformation | None] = []
        for i in range(6):
            used = [chains[k] for k in self.active[i]]
            out.append(merge_information([chain.information(i) for chain in used]) if used else None)
            if errors is not None:
                errors[i] = sum(float(chain.state.instrument[i, 3]) for chain in used)
        return out

    def least_squares(self, model: Vehicle | None = None) -> Estimate:
        """Learn by least squares with the couplings of `model`; where omitted they are learned along the way."""
        known, free = self._structure(None)
        informations = self._informations(model or self.vehicle, self.settings, known, free, learn=model is None)
        return self._assemble([self._by_least_squares(c, informations[c.axis.index]) for c in self.candidates])

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
        families: dict[_Family, list[AxisInformation | None]] = {}
        errors: dict[_Family, Array] = {}
        for family in _FAMILIES:
            known, free = self._structure(family)
            driven = self._driven(self._informations(model, self.settings, known, free, learn=False), known, free)
            misfit = np.zeros(6)
            informations: list[AxisInformation | None] = []
            for _ in range(_ITERATIONS):
                misfit = np.zeros(6)
                informations = self._informations(
                    model, self.settings, known, free, driven=driven, learn=False, errors=misfit
                )
                driven = self._driven(informations, known, free, instruments=True)
            families[family], errors[family] = informations, misfit
        return self._assemble([self._by_instruments(candidate, families, errors) for candidate in self.candidates])

    def _driven(
        self, informations: Sequence[AxisInformation | None], known: Array, free: Array, *, instruments: bool = False
    ) -> Array:
        """Return the coefficients (6, 5) that drive the instruments; mass 0 where an axis has none."""
        out = np.zeros((6, 5))
        for i, information in enumerate(informations):
            flags = tuple(bool(flag) for flag in free[i])
            if information is None or not flags[4]:
                continue
            solution = solve_axis(information, flags, known[i], instruments=instruments)
            if solution is None:
                flags = (*flags[:2], False, False, True)
                solution = solve_axis(information, flags, known[i], instruments=instruments)
            if solution is None or not solution.values[4] > 0.0:
                continue
            values = solution.values.copy()
            values[:2] = np.minimum(values[:2], 0.0)
            if not values[:2].any():
                values[0] = -values[4]
            out[i] = values
        return out

    def _by_instruments(
        self,
        candidate: Candidates,
        families: dict[_Family, list[AxisInformation | None]],
        errors: dict[_Family, Array],
    ) -> AxisFindings:
        i = candidate.axis.index
        first = families[_FAMILIES[0]][i]
        if first is None:
            return absent(candidate, _not_measured(candidate))

        def family(flags: Sequence[bool]) -> _Family:
            both = (bool(flags[0]), bool(flags[1]))
            return both if both in families else _FAMILIES[0]

        def solve(flags: tuple[bool, ...], known: Array) -> AxisSolution | None:
            information = families[family(flags)][i]
            return None if information is None else solve_axis(information, flags, known, instruments=flags[4])

        def cost(solution: AxisSolution) -> float:
            misfit = float(errors[family(solution.free)][i])
            return misfit / _QUADRATIC_MUST_GAIN if solution.free[1] and not solution.free[0] else misfit

        return select(candidate, solve, cost, commanded=first.commanded_share)

    def _assemble(self, findings: Sequence[AxisFindings]) -> Estimate:
        return estimate_of(self.vehicle, findings, self.duration, self.rows)


def _not_measured(candidate: Candidates) -> str:
    axis = candidate.axis
    return f"{axis.name} speed {axis.velocity} is not measured in these recordings"


def sources_of(grid: Grid) -> Sources:
    """Return where the velocities and the attitude of a grid come from."""
    return Sources.of(grid.pose, grid.velocity, grid.acceleration)


def spread_grids(grids: Sequence[Grid]) -> tuple[Grid, ...]:
    """Return stretches of the grids, see `spread_places`; the grids themselves where they are not long."""
    places = spread_places([grid.t for grid in grids])
    return tuple(grids) if places is None else tuple(_rows(grids[k], a, b) for k, a, b in places)


def _head(grid: Grid, seconds: float) -> Grid:
    """Return the first `seconds` of a grid."""
    n = int(np.searchsorted(grid.t, grid.t[0] + seconds))
    return grid if n >= len(grid) else _rows(grid, 0, n)


def _rows(grid: Grid, first: int, last: int) -> Grid:
    """Return the rows [first, last) of a grid, with the inputs that matter to them."""
    places = {name: slice(first, last) for name in ("t", "pose", "velocity", "acceleration", "fresh", "voltage")}
    for kind in ("command", "wrench"):
        stamps = getattr(grid, f"{kind}_t")
        begin, end = np.searchsorted(stamps, (grid.t[first] - INPUTS_BEFORE, grid.t[last - 1]), "right")
        places |= dict.fromkeys((f"{kind}_t", f"{kind}_values"), slice(max(0, int(begin) - 1), int(end)))
    return replace(grid, **{name: getattr(grid, name)[place] for name, place in places.items()})
