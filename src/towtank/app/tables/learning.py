"""What was learned, as tables and as a document, with the levels of noise and disturbance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from towtank.app.tables.fits import show_own_fits, usable_document
from towtank.app.terminal.output import Output
from towtank.digits import measured, short
from towtank.identification import Estimate
from towtank.identification.data.samples import NoiseLevels
from towtank.identification.model.terms import AXES
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.wording import surer_together
from towtank.intervals import interval, interval_text
from towtank.recording import STANDARD, Grid
from towtank.recording.axes import AxisKnown, axes_shown, known_text
from towtank.recording.consistency import Finding
from towtank.recording.standard import MEASURED
from towtank.report.verdict import learn_verdict
from towtank.validation import Usability
from towtank.vehicle import COEFFICIENTS

__all__ = [
    "delay_deviation",
    "disturbance_cells",
    "disturbance_document",
    "estimate_document",
    "findings_document",
    "late_texts",
    "learn_document",
    "noise_document",
    "pair_document",
    "show_findings",
    "show_learning",
    "supposed_values",
]

_KINDS = (
    ("noise of pose", slice(0, 6), "m, rad"),
    ("noise of speed", slice(6, 12), "m/s, rad/s"),
    ("noise of force", slice(12, 15), "m/s^2"),
    ("noise through water", slice(15, 18), "m/s"),
)
_VELOCITIES = ("u", "v", "w", "p", "q", "r")
_WHOLE = 2e-3  # s, deviation of a latency from which whole milliseconds say it
_METHODS = {
    "joint": "joint Kalman filter",
    "output-error": "output error (free runs)",
    "paper": "the paper's method (filtered regressors)",
}


def noise_document(levels: NoiseLevels | None, grids: Sequence[Grid]) -> dict[str, Any]:
    """Return the noise of each channel that was measured: standard deviation of a sample, and its unit."""
    if levels is None:
        return {}
    return {
        name: {"std": float(levels.noise[j]), "unit": STANDARD[name].unit}
        for j, name in enumerate(MEASURED)
        if _measured(grids)[j]
    }


def disturbance_document(levels: NoiseLevels | None, grids: Sequence[Grid]) -> dict[str, Any]:
    """Return the disturbance force of each axis whose motion is measured: its standard deviation and its unit."""
    if levels is None:
        return {}
    return {
        axis.wrench: {"std": float(level), "unit": STANDARD[axis.wrench].unit}
        for axis, level, moving in zip(AXES, levels.disturbance, _moving(grids), strict=True)
        if moving
    }


def show_levels(levels: NoiseLevels | None, grids: Sequence[Grid], output: Output, *, whose: str = "") -> None:
    """Print the levels of all axes side by side; nothing where there are none.

    Args:
        whose: picture of the disturbance it is, where that is not the model's.
    """
    if levels is None:
        return
    output.heading(f"Noise and disturbance{whose} (standard deviations)")
    table = output.table("", *(f">{axis.name}" for axis in AXES), "Unit")
    table.add_row("disturbance", *disturbance_cells(levels, grids), "N, N m")
    known = _measured(grids)
    for label, columns, unit in _KINDS:
        if known[columns].any():
            cells = [
                _brief(x) if measured else "-"
                for x, measured in zip(levels.noise[columns], known[columns], strict=True)
            ]
            table.add_row(label, *cells, *[""] * (6 - len(cells)), unit)
    output.show(table)


def disturbance_cells(levels: NoiseLevels, grids: Sequence[Grid]) -> list[str]:
    """Return the disturbance of each axis as text, "-" where its motion is not measured."""
    return [_brief(level) if moving else "-" for level, moving in zip(levels.disturbance, _moving(grids), strict=True)]


def _moving(grids: Sequence[Grid]) -> tuple[bool, ...]:
    """Return whether the motion along each axis is measured in any recording, by any channel."""
    return axes_shown({name for name, known in zip(MEASURED, _measured(grids), strict=True) if known})


def _brief(value: float) -> str:
    return f"{value:.2g}"


def _measured(grids: Sequence[Grid]) -> NDArray[np.bool_]:
    """Return which of the 18 columns are measured in any recording."""
    return np.asarray(np.any([grid.fresh.any(axis=0) for grid in grids], axis=0))


def show_learning(
    learning: LogLearning,
    fit: Mapping[str, float | None],
    use: Usability | None,
    logs: Sequence[Path],
    warnings: Sequence[str],
    output: Output,
    *,
    asked: str,
    prior: str | None = None,
    known: Sequence[AxisKnown] = (),
) -> None:
    """Print what was learned.

    Args:
        use: for how long the model predicts. asked: the method asked for. prior: what was known beforehand, as named.
            known: by what each axis is.
    """
    estimate = learning.estimate
    names = ", ".join(log.name for log in logs)
    output.line(_verdict(learning, fit, use), "bold")
    output.line()
    output.line(f"{learning.vehicle.name} from {names}", "bold")
    before = "" if prior is None else f", prior {prior}"
    output.line(f"{short(estimate.duration)} s, {estimate.samples} samples, method {learning.method}{before}")
    show_findings(learning.findings, output)
    _show_coefficients(learning, output)
    if estimate.sums:
        output.heading("Inertias as they move the vehicle (body and water together)")
        table = output.table("Sum", ">Value", ">± std", ">95 % interval", "Unit")
        for total in estimate.sums:
            row = (*measured(total.value, total.std), interval_text(total.value, total.std))
            table.add_row(total.name, *row, total.unit)
        output.show(table)
    _show_held(learning, output)
    _show_input(learning, output)
    if known:
        output.heading("By which channels each axis is known")
        output.line(known_text(known))
    whose = " as the joint filter sees them" if learning.method == "output-error" else ""
    show_levels(learning.levels, learning.grids, output, whose=whose)
    output.heading("Fit of the free-running prediction on the same logs")
    show_own_fits(fit, output)
    output.heading(f"How it was learned: {_METHODS.get(learning.method, learning.method)}")
    for text in (*learning.remarks, *_choice(learning, asked)):
        output.item(text)
    if warnings:
        output.heading("Warnings")
        for text in warnings:
            output.item(text)


def _verdict(learning: LogLearning, fit: Mapping[str, float | None], use: Usability | None) -> str:
    """Return what is to be known first."""
    predicted = "the logs that it was learned from"
    return learn_verdict(learning.estimate, fit, predicted, learning.findings, learning.driven, use).text


def show_findings(findings: Sequence[Finding], output: Output) -> None:
    """Print what cannot be right; nothing where all may be."""
    if findings:
        output.heading("What cannot be right")
        for each in findings:
            output.item(each.text)


def findings_document(findings: Sequence[Finding]) -> list[dict[str, str]]:
    """Return the findings for a JSON document."""
    return [{"what": each.what, "text": each.text} for each in findings]


def _choice(learning: LogLearning, asked: str) -> list[str]:
    if learning.remarks:
        return []
    if asked == "joint":
        return ["these logs allow no free runs to compare with"]
    return ["as chosen with --method"]


def _show_coefficients(learning: LogLearning, output: Output) -> None:
    learned = [each for each in learning.estimate.coefficients if each.identified]
    if not learned:
        return
    output.line()
    supposed = supposed_values(learning)
    table = output.table("Name", ">Value", ">± std", ">95 % interval", ">Prior" if supposed else ">Before", "Unit")
    for each in learned:
        if each.name in supposed:
            mean, std = supposed[each.name]
            before = f"{short(mean, 2)} ± {short(std, 2)}"
        else:
            before = short(_before(learning, each.name))
        row = (*measured(each.value, each.std), interval_text(each.value, each.std), before)
        table.add_row(each.name, *row, each.unit)
    output.show(table)


def supposed_values(learning: LogLearning) -> dict[str, tuple[float, float]]:
    """Return what was supposed of each coefficient, value and deviation; nothing where the method supposes nothing."""
    prior = learning.prior
    if prior is None:
        return {}
    pairs = zip(prior.names, prior.values.tolist(), prior.value_std.tolist(), strict=True)
    return {name: (value, std) for name, value, std in pairs if name in COEFFICIENTS}


def late_texts(latency: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return a line for each sensor whose clock is not that of the others.

    >>> late_texts({"velocity": (0.118, 0.003), "rates": (-0.0201, 0.0011)})
    ['velocity arrives 118 ± 3 ms late', 'rates arrive 20.1 ± 1.1 ms early']
    """
    out = []
    for sensor, (value, std) in latency.items():
        places = 0 if std >= _WHOLE else 1
        number, spread = f"{1e3 * abs(value):.{places}f}", f"{1e3 * std:.{places}f}"
        arrives = "arrive" if sensor.endswith("s") else "arrives"
        out.append(f"{sensor.replace('_', ' ')} {arrives} {number} ± {spread} ms {'late' if value >= 0.0 else 'early'}")
    return out


def _show_held(learning: LogLearning, output: Output) -> None:
    """Print what was not learned, with the value that the model keeps, grouped by the reason."""
    reasons: dict[str, list[str]] = {}
    for each in learning.estimate.coefficients:
        if not each.identified:
            reasons.setdefault(each.reason or "no reason given", []).append(f"{each.name} = {short(each.value)}")
    if reasons:
        output.heading("Not identified, and why")
        for reason, names in reasons.items():
            output.item(f"{', '.join(names)}: {reason}")


def _show_input(learning: LogLearning, output: Output) -> None:
    output.heading("From command to thrust")
    std = delay_deviation(learning)
    spread = "" if std is None else f" ± {1e3 * std:.1f}"
    found = "given" if learning.delay_given else "found"
    output.line(f"delay {1e3 * learning.delay:.1f}{spread} ms ({found})")
    if math.isfinite(learning.lag):
        value, spread = measured(1e3 * learning.lag, 1e3 * learning.lag_std)
        output.line(f"lag {value}{f' ± {spread}' if spread else ''} ms, first order (found)")
    else:
        lags = sorted({thruster.time_constant for thruster in learning.vehicle.thrusters if thruster.time_constant})
        if lags:
            output.line(f"lag {', '.join(short(1e3 * lag) for lag in lags)} ms, first order (of the vehicle file)")
    if (together := surer_together(std, learning.together)) is not None:
        output.line(f"together {' ± '.join(together)} ms; how much of that is lag is less sure")
    if learning.gains:
        gains = (f"{name} {gain:.3f} ± {std:.3f}" for name, (gain, std) in learning.gains.items())
        output.line(f"gain of each thruster, relative to its curve: {', '.join(gains)}")
    for text in late_texts(learning.latency):
        output.line(text)
    if learning.vehicle.scale_std and learning.vehicle.thrusters:
        output.line(
            f"scale of thrust known to {100.0 * learning.vehicle.scale_std:.3g} %, included in every deviation above"
        )


def delay_deviation(learning: LogLearning) -> float | None:
    """Return the deviation of the delay [s]; None where it was given or has none."""
    scan = learning.delay_scan
    std = learning.delay_std if scan is None or math.isfinite(learning.delay_std) else scan.std
    return std if math.isfinite(std) else None


def _before(learning: LogLearning, name: str) -> float | None:
    try:
        return learning.vehicle.coefficient(name)
    except ValueError:
        return None


def pair_document(pair: tuple[float, float] | None) -> dict[str, float] | None:
    """Return a value and its deviation, None where there is none."""
    return None if pair is None else {"value": pair[0], "std": pair[1]}


def learn_document(
    learning: LogLearning,
    fit: Mapping[str, float | None],
    use: Usability | None,
    warnings: Sequence[str],
    rmse: Mapping[str, float | None] | None = None,
    known: Sequence[AxisKnown] = (),
) -> dict[str, Any]:
    """Return the part of the JSON document that learning fills; known: by which channels each axis is."""
    estimate = learning.estimate
    return {
        "verdict": _verdict(learning, fit, use),
        "usable": usable_document(use),
        "findings": findings_document(learning.findings),
        "method": learning.method,
        "remarks": learning.remarks,
        "duration_s": estimate.duration,
        "samples": estimate.samples,
        "delay_s": learning.delay,
        "delay_std_s": delay_deviation(learning),
        "lag_s": learning.lag,
        "lag_std_s": learning.lag_std,
        "delay_and_lag_s": pair_document(learning.together),
        "gains": {name: pair_document(pair) for name, pair in learning.gains.items()},
        "current": None
        if learning.current is None
        else {"velocity_ned": list(learning.current.velocity), "std": list(learning.current.std)},
        "latency_s": {name: pair_document(pair) for name, pair in learning.latency.items()},
        "places_m": {name: pair_document(pair) for name, pair in learning.places.items()},
        "waves": _waves(learning),
        "scale_std": learning.vehicle.scale_std,
        **_narrowed(estimate_document(estimate), learning),
        "disturbance": disturbance_document(learning.levels, learning.grids),
        "noise": noise_document(learning.levels, learning.grids),
        "known_by": {each.axis: [asdict(witness) for witness in each.witnesses] for each in known},
        "fit": {**{name: fit.get(name) for name in _VELOCITIES}, **fit},
        "rmse": dict(rmse or {}),
        "warnings": list(warnings),
    }


def _waves(learning: LogLearning) -> dict[str, Any] | None:
    """Return the waves that were found: their period, the deviation of the water's velocity. None where none were."""
    if learning.levels is None or not math.isfinite(learning.wave_period):
        return None
    return {"period_s": learning.wave_period, "velocity_ned": learning.levels.waves}


def _narrowed(document: dict[str, Any], learning: LogLearning) -> dict[str, Any]:
    """Return the document of an estimate with what was supposed of each coefficient, and what is left of that."""
    supposed = supposed_values(learning)
    for name, entry in document["coefficients"].items():
        value, std = supposed.get(name, (None, None))
        entry["prior"] = None if value is None else {"value": value, "std": std}
        entry["narrowed"] = learning.narrowed.get(name)
    return document


def estimate_document(estimate: Estimate) -> dict[str, Any]:
    """Return the coefficients and the sums of inertias with their deviations, or reasons."""
    return {
        "coefficients": {
            each.name: {
                "value": each.value,
                "std": each.std,
                "interval": interval(each.value, each.std),
                "unit": each.unit,
                "identified": each.identified,
                "reason": each.reason,
            }
            for each in estimate.coefficients
        },
        "sums": {
            total.name: {
                "value": total.value,
                "std": total.std,
                "interval": interval(total.value, total.std),
                "unit": total.unit,
            }
            for total in estimate.sums
        },
    }
