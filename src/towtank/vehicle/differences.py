"""What differs between two models of a vehicle, by how much, with which deviation, and whether that is significant.

The deviations of both models count, as if they were independent; where a file gives none for a coefficient, the other's
alone does, and where neither does, a difference is told without a verdict. All quantities with a deviation together
make a chi-square; covariances of posteriors do not enter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from towtank.vehicle.names import COLUMNS, HYDRODYNAMIC, RESTORING, ROWS, index, short_words, unit
from towtank.vehicle.vehicle import Vehicle

__all__ = ["Difference", "Differences", "differences", "spoken"]

_SIGNIFICANT = 3.0  # deviations of one quantity
_LEVEL = 0.01  # of the chi-square
_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class Difference:
    """One quantity in two models: other - base.

    Attributes:
        name: a coefficient, `M_X .. M_N` for the total inertias (6, 6 diagonal of M_RB + M_A), or `gain_<thruster>`.
        text: the same in words. base, other: values; base_std, other_std: None where the file gives none.
        std: of the difference, None where unknown. deviations: |difference| / std, None likewise.
    """

    name: str
    text: str
    unit: str
    base: float
    other: float
    base_std: float | None
    other_std: float | None

    @property
    def difference(self) -> float:
        """The value of the other model less that of the base."""
        return self.other - self.base

    @property
    def std(self) -> float | None:
        """Standard deviation of the difference, None where neither file gives one."""
        given = [std for std in (self.base_std, self.other_std) if std is not None]
        return math.hypot(*given) if given and max(given) > 0.0 else None

    @property
    def deviations(self) -> float | None:
        """How many standard deviations the difference is, None where there are none."""
        return None if self.std is None else abs(self.difference) / self.std

    @property
    def significant(self) -> bool | None:
        """Whether it is more than three deviations; None where that cannot be said."""
        return None if self.deviations is None else self.deviations > _SIGNIFICANT

    @property
    def relative(self) -> float:
        """The difference as a share of the larger value, 0 .. 2."""
        largest = max(abs(self.base), abs(self.other))
        return abs(self.difference) / largest if largest > 0.0 else 0.0


@dataclass(frozen=True)
class Differences:
    """All quantities of two models.

    Attributes:
        chi_square: sum of squared deviations over `degrees` quantities; p: how likely one as large is by chance, None
            where no quantity has a deviation.
    """

    quantities: tuple[Difference, ...]
    chi_square: float
    degrees: int
    p: float | None

    @property
    def significant(self) -> bool | None:
        """Whether the models differ beyond their deviations, all quantities together; None where none has one."""
        return None if self.p is None else self.p < _LEVEL

    @property
    def largest(self) -> tuple[Difference, ...]:
        """What differs, the most significant first, then what has no deviation by relative size."""
        differing = [each for each in self.quantities if each.difference != 0.0]
        return tuple(sorted(differing, key=lambda each: (each.deviations is None, -(each.deviations or each.relative))))


def spoken(name: str) -> str:
    """Return a quantity in a few words, as `heave inertia` for M_Z or `surge quadratic drag` for X_uu.

    >>> spoken("M_Z"), spoken("N_rr"), spoken("W_minus_B")
    ('heave inertia', 'yaw quadratic drag', 'net weight W - B')
    """
    if name.startswith("M_") and name[2:] in ROWS and len(name) == 3:
        return f"{_AXES[ROWS.index(name[2])]} inertia"
    return short_words(name)


def differences(base: Vehicle, other: Vehicle) -> Differences:
    """Compare two models: total inertias, net weight, righting moments, drags, and whatever else one of them has.

    Gains of thrusters of the same name are told where they differ; files give no deviation of them.
    """
    quantities = [_inertia(base, other, i) for i in range(6)]
    for name in (*RESTORING, *HYDRODYNAMIC):
        kind, i, j = index(name)
        if kind == "mass" and i >= j:
            continue  # the diagonal is within the total inertias, the mirror is the same coefficient
        one = _quantity(base, other, name)
        if one.base != 0.0 or one.other != 0.0:
            quantities.append(one)
    quantities += _gains(base, other)
    squares = [each.deviations**2 for each in quantities if each.deviations is not None]
    total = math.fsum(squares)
    return Differences(tuple(quantities), total, len(squares), _chance(total, len(squares)))


def _chance(chi_square: float, degrees: int) -> float | None:
    if degrees == 0:
        return None
    from scipy.special import chdtrc

    return float(chdtrc(degrees, chi_square))


def _inertia(base: Vehicle, other: Vehicle, i: int) -> Difference:
    name = f"{ROWS[i]}_{COLUMNS[i]}dot"
    symbol = f"M_{ROWS[i]}"
    return Difference(
        symbol,
        spoken(symbol),
        unit(name),
        float(base.mass_matrix[i, i]),
        float(other.mass_matrix[i, i]),
        base.deviation(name),
        other.deviation(name),
    )


def _gains(base: Vehicle, other: Vehicle) -> list[Difference]:
    gains = {thruster.name: thruster.gain for thruster in other.thrusters}
    return [
        Difference(f"gain_{each.name}", f"gain of thruster {each.name}", "", each.gain, gains[each.name], None, None)
        for each in base.thrusters
        if gains.get(each.name, each.gain) != each.gain
    ]


def _quantity(base: Vehicle, other: Vehicle, name: str) -> Difference:
    return Difference(
        name,
        spoken(name),
        unit(name),
        base.coefficient(name),
        other.coefficient(name),
        base.deviation(name),
        other.deviation(name),
    )
