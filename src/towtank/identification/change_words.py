"""A change of the vehicle in words and numbers: which coefficients, by how much, how sure."""

from __future__ import annotations

import math

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.parameters import (
    CONSTANT,
    GAIN_PREFIX,
    LINEAR,
    MASS,
    MOMENT,
    PLAIN,
    QUADRATIC,
    WEIGHT,
    FreeParameters,
)
from towtank.vehicle import Vehicle

__all__ = ["change_details", "change_words"]

_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_SHOWN, _SURELY = 4, 2.0  # coefficients at most; deviations
_SIGN = {"-": "−"}


def change_words(
    vehicle: Vehicle,
    free: FreeParameters,
    before: tuple[Array, Array],
    now: tuple[Array, Array],
    *,
    thruster: str | None,
) -> str:
    """Return what changed in one line, the surest first.

    Args:
        before, now: coordinates (n,) and their deviations (n,).
        thruster: that is blamed, None for a change of the body.
    """
    step, std = now[0] - before[0], np.hypot(before[1], now[1])
    if thruster is not None:
        k = free.names.index(GAIN_PREFIX + thruster)
        share = 100.0 * math.exp(step[k])
        digits = 0 if share * std[k] >= 1.0 else 1
        return f"thruster {thruster}: {share:.{digits}f} ± {share * std[k]:.{digits}f} % of its thrust"
    told = [
        (abs(step[k]) / max(std[k], 1e-12), _one(vehicle, free, k, before[0][k], now[0][k], std[k]))
        for k in range(len(free))
        if std[k] > 0.0
    ]
    sure = [text for size, text in sorted(told, key=lambda each: -each[0]) if size > _SURELY and text]
    if sure:
        return ", ".join(sure[:_SHOWN])
    return "something about the body, not yet known what"


def change_details(
    vehicle: Vehicle, free: FreeParameters, before: tuple[Array, Array], now: tuple[Array, Array]
) -> dict[str, float]:
    """Return the step of every coefficient and its deviation, as X_udot and X_udot_std; gains as shares of before."""
    out: dict[str, float] = {}
    old, new = free.values(before[0]), free.values(now[0])
    std = np.hypot(np.abs(free.slopes(before[0])) * before[1], np.abs(free.slopes(now[0])) * now[1])
    for k, name in enumerate(free.names):
        if int(free.codes[k, 0]) in (MASS, LINEAR, QUADRATIC, WEIGHT, MOMENT, CONSTANT) or name.startswith(GAIN_PREFIX):
            out[name], out[f"{name}_std"] = float(new[k] - old[k]), float(std[k])
    return out


def _one(vehicle: Vehicle, free: FreeParameters, k: int, old: float, new: float, std: float) -> str:
    kind, i, _, transform = (int(code) for code in free.codes[k])
    name = free.names[k]
    if kind == MASS and transform != PLAIN:
        unit = "kg" if i < 3 else "kg m²"
        return f"{_AXES[i]} inertia {_signed(math.exp(new) - math.exp(old), math.exp(new) * std)} {unit}"
    if kind in (LINEAR, QUADRATIC) and transform != PLAIN:
        which = "linear drag" if kind == LINEAR else "drag"
        ratio = math.exp(new - old)
        return f"{_AXES[i]} {which} {_signed(100.0 * (ratio - 1.0), 100.0 * ratio * std)} %"
    if kind == WEIGHT:
        return f"net weight {_signed(new - old, std)} N"
    if kind == MOMENT and i == 2 and abs(old) > 0.0:
        share = 100.0 / abs(old)
        return f"roll and pitch stiffness {_signed((new - old) * share * math.copysign(1.0, old), std * share)} %"
    if kind in (MASS, LINEAR, QUADRATIC, MOMENT, CONSTANT):
        return f"{name} {_signed(new - old, std)}"
    return ""


def _signed(value: float, std: float) -> str:
    """Return a step and its deviation, to the first digits of the deviation: "+4.1 ± 0.3"."""
    digits = max(0, 1 - math.floor(math.log10(std))) if 0.0 < std < math.inf else 1
    digits -= digits > 0 and std * 10.0**digits >= 20.0
    text = f"{abs(value):.{min(digits, 6)}f}"
    return f"{'−' if value < 0.0 else '+'}{text} ± {std:.{min(digits, 6)}f}"
