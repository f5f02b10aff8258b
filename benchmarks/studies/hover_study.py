"""What forgetting does to a vehicle that hovers: 100 s of motion, 300 s of rest, then the same motion of a changed one.

    python benchmarks/studies/hover_study.py [--runs 20] [--output docs/images/changes] [--format svg]

Twice: on regressors of a surging vehicle with white noise of 1 % on each (three unknowns, a step of 30 % on all of
them after the rest), and through the whole of the paper's chain: surge of the Table II vehicle, poses at 100 Hz with
1 mm and 1 mrad of noise (drag 30 % higher and 2 kg more after the rest). lambda is 0.995 at 100 Hz, a memory of 2 s.
Prints a table and says what must hold and does not (exit code 1); with --output draws the figure `hover`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from figure_style import DASHED, DPI, DRAG, INK, MASS, dress, finished, line, log_ticks, panels_of
from matplotlib import rc_context
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from towtank.core.arrays import Array
from towtank.identification import PaperLearner, RecursiveLeastSquares
from towtank.outputs import write_atomically
from towtank.simulation import Mocap, simulate
from towtank.vehicle import Vehicle, load_vehicle

RATE, FORGETTING = 100, 0.995
EXCITED, HOVER, AFTER = 100, 300, 40  # s
PERIOD = 5.0  # s of the square wave
NOISE = 0.01  # of each regressor's root mean square
STEP = 1.3
ZEROS = 80_000
NEAR = 0.05  # "tracked": within, for good
SCHEMES = ("directional", "exponential")
COLOURS = dict(zip(SCHEMES, (MASS, DRAG), strict=True))
TRUTH = np.array([2.0, -3.0, 0.5])
POSE = ("x", "y", "z", "phi", "theta", "psi")
WORST = 1e4  # %, what is drawn of a coefficient that is lost
READ = np.concatenate([np.arange(5, 100, 5), np.arange(100, 400, 5), np.arange(400, 440, 0.5), [440.0]])  # s


@dataclass(frozen=True)
class Course:
    """The worst relative error over the coefficients [%] at times `t` [s], and the trace of P where there is one.

    `unrested` is the error after the change of an estimator that skipped the hover.
    """

    t: Array
    error: Array
    trace: Array
    unrested: Array

    def at(self, t: float) -> float:
        """Error [%] at a time."""
        return float(self.error[np.searchsorted(self.t, t)])

    def tracked(self, *, rested: bool = True) -> float:
        """Seconds from the change until the error stays below `NEAR`."""
        after = self.t > EXCITED + HOVER
        error = self.error[after] if rested else self.unrested
        away = np.flatnonzero(~(error <= 100.0 * NEAR))
        t = self.t[after] - EXCITED - HOVER
        return 0.0 if away.size == 0 else float(t[away[-1] + 1]) if away[-1] + 1 < t.size else np.inf


def square(seconds: float, amplitude: float) -> Array:
    """A square wave in surge, wrench (n, 6)."""
    t = np.arange(round(seconds * RATE)) / RATE
    wrench = np.zeros((t.size, 6))
    wrench[:, 0] = np.where((t % PERIOD) < 0.5 * PERIOD, amplitude, -amplitude)
    return wrench


def regressors(seed: int) -> tuple[Array, Array]:
    """Phi (n, 3) = [u, u|u|, force] of the whole course with noise, and y (n,); what is true changes after the rest."""
    force = square(EXCITED, 1.0)[:, 0]
    u = np.zeros(force.size)
    for k in range(force.size - 1):
        u[k + 1] = u[k] + (force[k] - 0.3 * u[k] - abs(u[k]) * u[k]) / RATE
    moving = np.column_stack([u, np.abs(u) * u, force])
    Phi = np.vstack([moving, np.zeros((HOVER * RATE, 3)), moving[: AFTER * RATE]])
    change = (EXCITED + HOVER) * RATE
    y = np.concatenate([Phi[:change] @ TRUTH, Phi[change:] @ (STEP * TRUTH)])
    rng = np.random.default_rng(seed)
    level = NOISE * np.sqrt(np.mean(moving**2, axis=0))
    return Phi + level * rng.normal(size=Phi.shape), y + NOISE * np.std(moving @ TRUTH) * rng.normal(size=y.size)


def on_regressors(scheme: str, seed: int, noise: float = 0.0) -> Course:
    """One run on plain regressors."""
    Phi, y = regressors(seed)
    rested, unrested = (
        RecursiveLeastSquares(3, forgetting=FORGETTING, scheme=scheme, noise=noise) for _ in range(2)
    )  # fmt: skip
    errors, traces, without = [], [], []
    change, begin = (EXCITED + HOVER) * RATE, 0
    unrested.run(Phi[: EXCITED * RATE], y[: EXCITED * RATE])
    for t in READ:
        end = round(t * RATE)
        rested.run(Phi[begin:end], y[begin:end])
        truth = TRUTH if end <= change else STEP * TRUTH
        errors.append(100.0 * np.abs(rested.theta / truth - 1.0).max())
        traces.append(np.trace(rested.P))
        if end > change:
            unrested.run(Phi[begin:end], y[begin:end])
            without.append(100.0 * np.abs(unrested.theta / truth - 1.0).max())
        begin = end
    return Course(READ, np.array(errors), np.array(traces), np.array(without))


def tank_vehicle() -> tuple[Vehicle, Vehicle]:
    """The Table II vehicle pushed by a wrench, as it is and with its payload."""
    vehicle = load_vehicle("seamor").model_copy(update={"thrusters": ()})
    payload = {"X_uu": STEP * vehicle.coefficient("X_uu"), "X_udot": vehicle.coefficient("X_udot") - 2.0}
    return vehicle, vehicle.with_coefficients(payload)


def through_chain(scheme: str, seed: int) -> Course:
    """One run through the paper's chain, sample by sample, from poses of a motion capture."""
    vehicle, heavy = tank_vehicle()
    wrenches = (square(EXCITED, 20.0), np.zeros((HOVER * RATE, 6)), square(AFTER, 20.0))
    rested, unrested = (PaperLearner(vehicle, forgetting=FORGETTING, scheme=scheme) for _ in range(2))
    errors, without = [], []
    for stage, (began, wrench) in enumerate(zip((0, EXCITED, EXCITED + HOVER), wrenches, strict=True)):
        truth = heavy if stage == 2 else vehicle
        log = simulate(truth, wrench=wrench, sensors=Mocap(jump_fraction=0.0), seed=3 * seed + stage)
        pose = np.column_stack([log[name].values for name in POSE])
        learners = (rested,) if stage == 1 else (rested, unrested)
        for learner in learners:
            learner.restart()
        due = {round(t * RATE) - began * RATE for t in READ if began < t <= began + len(wrench) / RATE}
        for k in range(len(wrench)):
            for learner in learners:
                learner.update(k / RATE, pose=pose[k], wrench=wrench[k])
            if k + 1 in due:
                errors.append(_chain_error(rested, truth))
                if stage == 2:
                    without.append(_chain_error(unrested, truth))
    return Course(READ, np.array(errors), np.full(READ.size, np.nan), np.array(without))


def _chain_error(learner: PaperLearner, truth: Vehicle) -> float:
    """Return the worse of the errors of inertia and drag [%]; `WORST` where one is not identified."""
    estimate = learner.estimate
    found, drag = estimate["X_udot"], estimate["X_uu"]
    if not (found.identified and drag.identified):
        return WORST
    inertia = truth.rigid_body.mass - found.value
    return 100.0 * max(abs(inertia / truth.mass_matrix[0, 0] - 1.0), abs(drag.value / truth.coefficient("X_uu") - 1.0))


def zeros_change_nothing(scheme: str) -> bool:
    """Whether 80,000 rows of zeros leave the estimate where it was, and P finite."""
    Phi, y = regressors(0)
    rls = RecursiveLeastSquares(3, forgetting=FORGETTING, scheme=scheme)
    rls.run(Phi[: EXCITED * RATE], y[: EXCITED * RATE])
    before = rls.theta
    rls.run(np.zeros((ZEROS, 3)), np.zeros(ZEROS))
    return bool(np.isfinite(rls.P).all() and np.allclose(rls.theta, before, rtol=1e-9, atol=0.0))


def median(courses: Sequence[Course], field: str) -> Array:
    """Return the median over the runs of one field of the courses."""
    return np.asarray(np.median([getattr(course, field) for course in courses], axis=0))


def failures(name: str, courses: dict[str, list[Course]]) -> list[str]:
    """Return what must hold and does not, for the default scheme."""
    out = []
    for k, course in enumerate(courses["directional"]):
        moved = abs(course.at(EXCITED + 200.0) - course.at(float(EXCITED)))
        if not moved <= 1.0:
            out.append(f"{name}, run {k}: 200 s of hover moved the error by {moved:.2f} %")
        held = course.trace[(course.t >= EXCITED) & (course.t <= EXCITED + HOVER)]
        if not np.isnan(held).all() and not held.max() <= 3.0 * held[0]:
            out.append(f"{name}, run {k}: the trace of P grew {held.max() / held[0]:.1f} times while hovering")
    rested = np.median([course.tracked() for course in courses["directional"]])
    plain = np.median([course.tracked(rested=False) for course in courses["exponential"]])
    if not rested <= plain + 1.0:
        out.append(
            f"{name}: the change is tracked {rested:.1f} s after the hover, by exponential forgetting {plain:.1f}"
        )
    return out


def shown(name: str, courses: dict[str, list[Course]], console: Console) -> None:
    """Print one table."""
    table = Table(title=name)
    for column in (
        "scheme",
        "error at 100 s",
        "50 s of hover",
        "200 s",
        "300 s",
        "trace P, x",
        "5 % after",
        "unrested",
    ):
        table.add_column(column, justify="left" if column == "scheme" else "right")
    for scheme, runs in courses.items():
        error, trace = median(runs, "error"), median(runs, "trace")
        hover = (READ >= EXCITED) & (READ <= EXCITED + HOVER)
        cells = [_percent(error[np.searchsorted(READ, t)]) for t in (100.0, 150.0, 300.0, 400.0)]
        growth = "-" if np.isnan(trace).all() else f"{trace[hover].max() / trace[hover][0]:.3g}"
        times = [float(np.median([run.tracked(rested=rested) for run in runs])) for rested in (True, False)]
        table.add_row(scheme, *cells, growth, *(f"{t:.1f} s" for t in times))
    console.print(table)


def _percent(error: float) -> str:
    return f"{error:.2f} %" if error < WORST else "lost"


def hover_figure(courses: dict[str, dict[str, list[Course]]]) -> Figure:
    """Draw the error over time, one panel for each experiment."""
    figure, panels = panels_of(
        len(courses), "Worst error of a coefficient while a vehicle moves, hovers and has changed"
    )
    for axes, (name, schemes) in zip(panels, courses.items(), strict=True):
        axes.axvspan(EXCITED, EXCITED + HOVER, color="#eef2f5", linewidth=0)
        for scheme, runs in schemes.items():
            error = np.clip(median(runs, "error"), 0.05, 1000.0)
            axes.semilogy(READ, error, color=COLOURS[scheme], linewidth=1.5)
        axes.set_xlim(0.0, READ[-1])
        axes.set_ylim(0.05, 1000.0)
        axes.axhline(1.0, color=INK, linewidth=0.6, linestyle=DASHED)
        axes.text(EXCITED + 0.5 * HOVER, 500.0, "hover", ha="center", va="center", fontsize=8.5, color=INK)
        dress(axes, name, "%")
        log_ticks(axes)
    return finished(figure, panels, [*(line(COLOURS[s], s) for s in SCHEMES), line(INK, "1 %", DASHED, 0.6)])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="seeds of each experiment (default 20)")
    parser.add_argument("--output", type=Path, help="folder of the figure")
    parser.add_argument("--format", choices=("svg", "png"), default="svg", help="of the figure (default svg)")
    options = parser.parse_args(argv)
    console = Console()
    console.width = max(console.width, 120)
    experiments = {"regressors, 1 % of noise": on_regressors, "the paper's chain, 1 mm": through_chain}
    wrong = [f"{scheme}: zeros move it" for scheme in SCHEMES if not zeros_change_nothing(scheme)]
    courses: dict[str, dict[str, list[Course]]] = {}
    for name, run in experiments.items():
        courses[name] = {scheme: [run(scheme, seed) for seed in range(options.runs)] for scheme in SCHEMES}
        shown(f"{name}, median of {options.runs} runs", courses[name], console)
        wrong += failures(name, courses[name])
    if options.output:
        options.output.mkdir(parents=True, exist_ok=True)
        with rc_context({"svg.hashsalt": "towtank", "svg.fonttype": "none"}):
            metadata = {"Date": None} if options.format == "svg" else None
            write = partial(hover_figure(courses).savefig, format=options.format, dpi=DPI, metadata=metadata)
            write_atomically(options.output / f"hover.{options.format}", write)
    for text in wrong:
        sys.stdout.write(f"does not hold: {text}\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
