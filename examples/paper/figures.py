"""Redraw figures 4, 5, 7 and 8 to 12 of the paper from simulation.

    python examples/paper/figures.py --output docs/images/paper

Where the paper shows its tank, a simulated vLBV300 takes its place: pose at 100 Hz with 1 mm and 1 mrad of noise and
occlusion jumps, 200 ms from command to thrust, and a disturbance (0.5 N in figure 7, as in `errors.py`; figures 8 to 12
show a calm tank: 0.1 N, or 0.01 N m when it yaws). The paper's way stands beside the mended one.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from chain import Array, Chain
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image
from seamor import EXPERIMENTS, RATE, TABLE_I, perform, rigid_body_only, truth
from tank import (
    AXES,
    CALM,
    CALM_YAW,
    DELAY,
    REAL,
    TankRun,
    percent,
    run,
    tank_vehicle,
    true_values,
    with_values,
    without_coefficients,
)

from towtank import Vehicle, simulate
from towtank.identification import PaperLearner, learn_paper
from towtank.vehicle import curve_force

PAPER_WAY = Chain(lowpass=2.0)
TRUTH, PAPER, MENDED, MEASURED = "#222222", "#d55e00", "#0072b2", "#9a9a9a"
STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}

# For each axis, what its model is learned from and judged on.
TRAINING = {"surge": "paper-stairs", "sway": "sway-stairs", "heave": "heave-stairs", "yaw": "yaw-stairs"}
TRIAL = {"surge": "paper-square", "sway": "sway-square", "heave": "heave-square", "yaw": "yaw-square"}
SECONDS = {"surge": 16.5, "sway": 20.0, "heave": 20.0, "yaw": 20.0}


# -- figure 4


def thruster_curve() -> Figure:
    """Return figure 4: force over command, as printed in (7) and as it is used."""
    curve = tank_vehicle().thrusters[0].curve
    command = np.linspace(-102.0, 102.0, 2041)
    figure, ax = plt.subplots(figsize=(7.2, 3.4))
    ax.plot(command, 0.006736 * command**2 - 0.03366 * command + 0.0684, color=PAPER, ls="--", label="(7) as printed")
    ax.plot(command, curve_force(curve, command), color=MENDED, label="with the sign of the command, dead band")
    for side in (-1, 1):
        ax.axvspan(*sorted((10 * side, 60 * side)), color="#e8f1f8", lw=0, zorder=0)
        ax.text(35 * side, -57, "fitted, 10 to 60", ha="center", color="#4a7fa5", fontsize=9)
    ax.set(xlabel="command (PWM)", ylabel="force [N]", xlim=(-102, 102), ylim=(-62, 78))
    ax.legend(loc="upper center")
    inner = ax.inset_axes((0.84, 0.12, 0.14, 0.26))
    near = np.abs(command) <= 10.0
    inner.plot(command[near], curve_force(curve, command[near]), color=MENDED)
    inner.set_title("dead band", fontsize=8)
    inner.tick_params(labelsize=7)
    return figure


# -- figures 5 and 7


def simulator_convergence(seconds: float = 10.0) -> Figure:
    """Return figure 5: surge of the Seamor, perfect sensors, sine."""
    found = perform(truth(), replace(EXPERIMENTS[0], duration=seconds), "smooth")
    learner = PaperLearner(rigid_body_only(), a=2.0, inputs="smooth", free=("X_udot", "X_uu"))
    times, values = [], []
    samples = zip(found.t, found.pose, found.velocity, found.wrench, strict=True)
    for k, (t, pose, velocity, wrench) in enumerate(samples):
        learner.update(t, pose=pose, velocity=velocity, wrench=wrench)
        if k % 2 == 0:
            estimate = learner.estimate
            known = [estimate[name].value if estimate[name].identified else np.nan for name in ("X_udot", "X_uu")]
            times.append(t)
            values.append(known)
    figure, ax = plt.subplots(figsize=(7.2, 3.0))
    for j, (name, color) in enumerate((("X_udot", MENDED), ("X_uu", PAPER))):
        printed = TABLE_I[name][0]
        true = float(printed)
        ax.semilogy(times, np.abs(np.array(values)[:, j] / true - 1.0), color=color, label=name)
        last = 0.5 * 10.0 ** -len(printed.partition(".")[2]) / abs(true)
        ax.axhline(last, color=color, lw=0.9, ls=":")
        text = f"{name} = {printed}: right to the last digit below this"
        ax.text(seconds, 1.7 * last, text, ha="right", color=color, fontsize=9)
    ax.set(xlabel="time [s]", ylabel="relative error", xlim=(0, seconds))
    ax.legend(loc="upper center", ncols=2)
    return figure


def surge_convergence(seed: int = 0) -> Figure:
    """Return figure 7: surge of the vLBV300 with the errors of the real chain, the paper's way and mended."""
    vehicle = tank_vehicle()
    true = true_values(vehicle, "surge")
    found = run(vehicle, "surge", "paper-stairs", REAL, seed)
    paper = PAPER_WAY.history(found.t, found.velocity(PAPER_WAY), found.force)
    times, mended = _mended_history(found, vehicle)
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 3.1))
    labels = ("total surge mass $m - X_{\\dot u}$ [kg]", "drag $-X_{u|u|}$ [kg/m]")
    for j, (ax, label) in enumerate(zip(axes, labels, strict=True)):
        ax.axhspan(0.95 * true[j], 1.05 * true[j], color="#ececec", lw=0, label="truth, 5 % either way")
        ax.axhline(true[j], color=TRUTH, lw=0.9, ls=":")
        ax.plot(found.t[1:], paper[:, j], color=PAPER, label="the paper's way")
        ax.plot(times, mended[:, j], color=MENDED, label="towtank, same filter on the thrust, delay known")
        ax.set(xlabel="time [s]", ylabel=label, xlim=(0, found.t[-1]), ylim=(0.0, 2.0 * true[j]))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=9)
    return figure


def _mended_history(found: TankRun, vehicle: Vehicle) -> tuple[Array, Array]:
    """Return times (k,) and M, D (k, 2) of towtank's learner."""
    learner = PaperLearner(without_coefficients(vehicle, "surge"), free=("X_udot", "X_uu"), delay=DELAY)
    pose = np.column_stack([found.recording[name].values for name in ("x", "y", "z", "phi", "theta", "psi")])
    commands = found.asked.commands
    assert commands is not None
    times, values = [], []
    for k, t in enumerate(found.t):
        learner.update(t, pose=pose[k], commands=commands[k] if k < len(commands) else None)
        if k % 5 == 0 and t > 0.6:
            estimate = learner.estimate
            good = estimate["X_udot"].identified and estimate["X_uu"].identified
            values.append(true_values(learner.model(), "surge") if good else (np.nan, np.nan))
            times.append(t)
    return np.array(times), np.array(values)


# -- figures 8 to 12


@cache
def models(axis: str, seed: int = 5) -> tuple[Vehicle, Vehicle]:
    """Return the models of one axis that the paper's chain and towtank learn from one run."""
    vehicle = tank_vehicle()
    conditions = replace(REAL, disturbance=CALM_YAW if axis == "yaw" else CALM)
    found = run(vehicle, axis, TRAINING[axis], conditions, seed, duration=SECONDS[axis])
    M, D = PAPER_WAY.learn(found.t, found.velocity(PAPER_WAY), found.force)
    learned = learn_paper(without_coefficients(vehicle, axis), [found.recording], free=AXES[axis][3:])
    return with_values(vehicle, axis, M, D), learned.model


@cache
def trial(axis: str, seed: int = 6) -> tuple[TankRun, Array, Array]:
    """Return a run that no model has seen, and coordinate and velocity that both models predict (n, 2) each.

    The paper knew no delay and shifted its predictions by hand; so is the prediction of its model here.
    """
    _, coordinate, velocity, *_ = AXES[axis]
    conditions = replace(REAL, disturbance=CALM_YAW if axis == "yaw" else CALM)
    found = run(tank_vehicle(), axis, TRIAL[axis], conditions, seed, duration=SECONDS[axis])
    logs = [simulate(model, **found.asked.inputs, delay=model.command_delay or DELAY) for model in models(axis)]
    columns = [np.column_stack([log[name].values for log in logs]) for name in (coordinate, velocity)]
    return found, columns[0], columns[1]


def _compare(ax: Axes, t: Array, measured: Array, predicted: Array, label: str) -> None:
    ax.plot(t, measured, color=MEASURED, lw=3.0, label="measured (simulated)")
    ax.plot(t, predicted[:, 0], color=PAPER, ls="--", label="learned the paper's way")
    ax.plot(t, predicted[:, 1], color=MENDED, label="learned by towtank")
    ax.set(xlabel="time [s]", ylabel=label, xlim=(0, t[-1]))


def displacement(axis: str, label: str, scale: float = 1.0) -> Figure:
    """Return one of figures 8, 10, 11, 12: free-running prediction of a coordinate."""
    found, predicted, _ = trial(axis)
    figure, ax = plt.subplots(figsize=(7.2, 3.0))
    _compare(ax, found.t, scale * found.coordinate, scale * predicted, label)
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=9)
    return figure


def surge_velocity() -> Figure:
    """Return figure 9: surge velocity by difference and low-pass, the predictions through the same low-pass."""
    found, _, predicted = trial("surge")
    smoothed = PAPER_WAY.smooth(found.velocity(PAPER_WAY), 1.0 / RATE)
    predicted = np.column_stack([PAPER_WAY.smooth(column, 1.0 / RATE) for column in predicted.T])
    figure, ax = plt.subplots(figsize=(7.2, 3.0))
    _compare(ax, found.t, smoothed, predicted, "surge velocity $u$ [m/s]")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=9)
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "figure-04-thruster-curve": thruster_curve,
    "figure-05-simulator-convergence": simulator_convergence,
    "figure-07-surge-convergence": surge_convergence,
    "figure-08-surge-displacement": lambda: displacement("surge", "surge displacement $x$ [m]"),
    "figure-09-surge-velocity": surge_velocity,
    "figure-10-sway-displacement": lambda: displacement("sway", "sway displacement $y$ [m]"),
    "figure-11-yaw-displacement": lambda: displacement("yaw", "heading $\\psi$ [deg]", 180.0 / np.pi),
    "figure-12-heave-displacement": lambda: displacement("heave", "heave displacement $z$ [m]"),
}


def draw(folder: Path, names: Sequence[str] = tuple(FIGURES)) -> list[Path]:
    """Draw figures into a folder as PNG files; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context(STYLE):
        for name in names:
            figure = FIGURES[name]()
            written.append(folder / f"{name}.png")
            picture = BytesIO()
            figure.savefig(picture, dpi=130)
            plt.close(figure)
            Image.open(picture).convert("RGB").quantize(48).save(written[-1], optimize=True)
    return written


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw all figures, and say how well the models predict."""
    parser = argparse.ArgumentParser(description="Redraw the paper's figures from simulation.")
    parser.add_argument("--output", type=Path, default=Path("paper-figures"), help="folder for the PNG files")
    options = parser.parse_args(arguments)
    mpl.use("Agg")
    for path in draw(options.output):
        print(f"{path}  {path.stat().st_size / 1000:.0f} kB")
    for axis in AXES:
        report(axis)


def report(axis: str) -> None:
    """Print what the models of one axis are and how far they come from the run that they predict."""
    true = true_values(tank_vehicle(), axis)
    found, predicted, _ = trial(axis)
    rms = np.sqrt(np.mean((predicted - found.coordinate[:, None]) ** 2, axis=0))
    span = float(np.ptp(found.coordinate))
    print(f"{axis}: truth M = {true[0]:.2f}, D = {true[1]:.3f}; {AXES[axis][1]} measured over a span of {span:.3f}")
    for name, model, error in zip(("the paper's way", "towtank"), models(axis), rms, strict=True):
        M, D = percent(true_values(model, axis), true)
        print(f"  {name:16s} M {M:+6.1f} %  D {D:+6.1f} %  RMS error {error:.3f}")


if __name__ == "__main__":
    main()
