"""Learning from recordings as wholes: delay, least squares, then instruments driven by the commands alone.

Least squares takes whatever moves with the motion for an effect of the motion; on real logs slow disturbances answer
to the speed and inflate the inertia. A second set of regressors, simulated from the commands with the coefficients
found so far, knows nothing of the disturbance: with these as instruments the bias is gone, and the result hardly
depends on the filter constant (the refined instrumental variable method; Young, Recursive Estimation and Time-Series
Analysis, 2011). Each pass is the streaming kernel's own, over all recordings; structure and couplings follow between
passes.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from towtank.errors import InputError
from towtank.identification.axes import AXES
from towtank.identification.chain import Settings
from towtank.identification.delay import DelayScan
from towtank.identification.estimate import Estimate, with_shift
from towtank.identification.log_learning import LogLearning
from towtank.identification.passes import Passes, Progress, sources_of, spread_grids
from towtank.identification.structure import candidates
from towtank.recording import Grid, Recording, align, bind_thrusters
from towtank.vehicle import Vehicle

__all__ = ["estimate_warnings", "learn_paper"]

_ROUNDS = 12  # at most; each with the couplings of what the last one learned
_SETTLED = 0.1  # deviations, or a thousandth of its value, that nothing may move any more


def learn_paper(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    *,
    free: Collection[str] | None = None,
    delay: float | None = None,
    longest_delay: float = 0.4,
    a: float = 3.0,
    lowpass: float = 4.0,
    instruments: bool = True,
    sparing: bool = False,
    progress: Progress | None = None,
) -> LogLearning:
    """Learn a vehicle's coefficients from one or several recordings by the paper's method.

    Args:
        free: names of the coefficients to learn, see `Learner`.
        delay: from command (or recorded wrench) to force [s]; found by scanning up to `longest_delay` where omitted.
        a, lowpass: see `Learner`.
        instruments: remove the bias of least squares with command-driven instruments.
        sparing: of long recordings learn from stretches, evenly spread.
        progress: called with a text and the share done, 0 .. 1.

    Raises:
        InputError: no recording, no motion, no commands, thrusters that the vehicle lacks, an unknown name.
    """
    if not recordings:
        raise InputError("no recording given, expected at least one")
    if not 0.0 <= longest_delay < 10.0:
        raise InputError(f"longest_delay: found {longest_delay}, expected seconds between 0 and 10")
    told = progress or (lambda text, share: None)
    told("aligning", 0.0)
    names = [thruster.name for thruster in vehicle.thrusters]
    grids = tuple(align(bind_thrusters(recording, names)) for recording in recordings)
    used = spread_grids(grids) if sparing else grids
    passes = Passes(vehicle, used, Settings(a=a, lowpass=lowpass, delay=delay or 0.0), candidates(vehicle, free))
    scan = None
    if delay is None:
        told("delay", 0.05)
        scan = passes.find_delay(longest_delay, told)
        passes = Passes(vehicle, used, replace(passes.settings, delay=scan.delay), passes.candidates)
    told("least squares", 0.4)
    estimate = passes.least_squares()
    for _ in range(_ROUNDS):
        last = estimate
        estimate = passes.least_squares(last.model(vehicle))
        if _settled(last, estimate):
            break
    for round_ in range(_ROUNDS if instruments else 0):
        told("instruments", 0.5 + 0.4 * round_ / _ROUNDS)
        last = estimate
        estimate = passes.with_instruments(last.model(vehicle))
        if _settled(last, estimate):
            break
    if instruments and scan is not None and np.isfinite(scan.std):
        told("deviations", 0.95)
        late = Passes(vehicle, used, replace(passes.settings, delay=scan.delay + scan.std), passes.candidates)
        estimate = with_shift(estimate, late.with_instruments(estimate.model(vehicle)))
    told("done", 1.0)
    found = passes.settings.delay
    model = estimate.model(vehicle, "learned by towtank, method paper")
    if any(passes.commands):
        model = model.model_copy(update={"command_delay": found})
    warnings = _warnings(vehicle, estimate, scan, longest_delay, grids)
    return LogLearning(vehicle, estimate, model, found, scan, grids, tuple(map(sources_of, grids)), warnings)


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
