"""Terms that a model may lack, in the order in which free runs try them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.identification.parameters import GAIN_PREFIX, LAG
from towtank.identification.samples import Samples
from towtank.vehicle import Vehicle, configuration_matrix
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["RIGHTING", "groups_of_terms", "righting"]

RIGHTING = "BG_z"

_FEWEST = 3  # thrusters, of which most give what their curves say

_COUPLED = {3: (4, 5), 4: (3, 5), 5: (3, 4), 1: (5,), 2: (4,)}  # rows, and the speeds that may act on them


def groups_of_terms(
    vehicle: Vehicle, names: Sequence[str], samples: Sequence[Samples], *, find_lag: bool
) -> tuple[tuple[str, ...], ...]:
    """Return groups of names: constant forces, gains of thrusters, lag, other damping terms, couplings by speed.

    Args:
        names: what is free already; an axis is modelled where its inertia is or its damping.
        find_lag: whether the thrusters' lag is asked for.
    """
    axes = [i for i in range(6) if any(name in names for name in _own(i))]
    measured = np.any([each.measured for each in samples], axis=0)
    fed = [i for i in range(6) if measured[6 + i] or measured[i]]
    constants = [f"{ROWS[i]}_0" for i in axes]
    if "BG_z" in names:
        constants += ["BG_x", "BG_y"]
    damping = []
    for i in axes:
        linear, quadratic = f"{ROWS[i]}_{COLUMNS[i]}", f"{ROWS[i]}_{COLUMNS[i] * 2}"
        known = [name for name in (linear, quadratic) if vehicle.coefficient(name) != 0.0]
        damping += known or [linear, quadratic]
    couplings = [f"{ROWS[i]}_{COLUMNS[j]}" for i in axes for j in _coupled(i) if j in axes and j in fed and i in fed]
    gains = _gains(vehicle, axes, samples) if all(each.commands for each in samples) else ()
    return (tuple(constants), gains, (LAG,) if find_lag else (), tuple(damping), tuple(couplings))


def _gains(vehicle: Vehicle, axes: Sequence[int], samples: Sequence[Samples]) -> tuple[str, ...]:
    """Return the gains of the driven thrusters that act along the modelled axes, where they can be compared.

    All forces together have no scale of their own, so one thruster is told from the others, or not at all.
    """
    acts = np.any(configuration_matrix(vehicle)[list(axes)] != 0.0, axis=0)
    driven = np.any([np.nanmax(each.input_force, axis=0) > np.nanmin(each.input_force, axis=0) for each in samples], 0)
    chosen = [each.name for each, one in zip(vehicle.thrusters, acts & driven, strict=True) if one]
    return tuple(GAIN_PREFIX + name for name in chosen) if len(chosen) >= _FEWEST else ()


def righting(names: Sequence[str], samples: Sequence[Samples]) -> tuple[str, ...]:
    """Return the name of the righting moment where it is not free and the attitude is measured, else nothing.

    A vehicle stays level under its thrusters or tips: that alone tells of its righting moment, even where nothing else
    of roll and pitch can be learned, and a free run that tips over is of no use to the other axes.
    """
    measured = np.any([each.measured for each in samples], axis=0)
    return (RIGHTING,) if RIGHTING not in names and measured[3] and measured[4] else ()


def _coupled(i: int) -> tuple[int, ...]:
    both = list(_COUPLED.get(i, ()))
    both += [j for j, others in _COUPLED.items() if i in others and j not in both]
    return tuple(sorted(both))


def _own(i: int) -> tuple[str, ...]:
    row, column = ROWS[i], COLUMNS[i]
    return f"{row}_{column}dot", f"{row}_{column}", f"{row}_{column}{column}"
