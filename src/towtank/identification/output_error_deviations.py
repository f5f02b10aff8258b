"""How far the coefficients of a free run may be off: a covariance that honours residuals that are not white.

    Cov = kappa^2 I^-1 S I^-1,   I the information that is left once the initial states are unknown,

S the long-run covariance of its score, a prewhitened Bartlett sum over blocks of time (`axis_solution.long_run`) that
reaches as far as the residuals remember, and kappa = sum of weights / sum of psi' (Huber, Robust Statistics, section
7.6). The sum varies itself, the more the fewer of its reaches the run is long: intervals are widened by the share of
the run that it takes in (Kiefer and Vogelsang, Econometric Theory 21, 2005, at 95 %). No coefficient is taken
to be better known than white residuals of their own size would have it.

Of a random force slower than the run, the run takes most for motion: nothing of it is left in the residuals, and no sum
over them can tell. Residuals that remember more than about a twentieth of the run mean intervals that are too short.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.axis_solution import long_run
from towtank.identification.output_error_solution import inverse_information

__all__ = ["coefficient_covariance"]

_STATES = 2  # of each segment, a position and a velocity, that share in a coefficient's own axis
_CONTAMINATED = 1.5  # largest kappa


def coefficient_covariance(
    information: Array, prior: Array, scores: Array, segments: int, moments: Array, reach: float, block: float
) -> Array:
    """Return the covariance (n, n) of the coefficients.

    Args:
        information: (n, n) of the run and the prior together. prior: (n, n).
        scores: (b, n) of blocks of time, the initial states eliminated.
        segments: number of free runs. moments: of `robust_moments`.
        reach: time [s] that the residuals remember. block: length of a block [s].
    """
    n = len(information)
    inverse = inverse_information(information)
    number, weights, straight, squares, _ = moments
    kappa = min(weights / straight, _CONTAMINATED) if straight > 0.0 else _CONTAMINATED
    size = squares / max(number - n - 12.0 * segments, 1.0) * number / weights if weights > 0.0 else 1.0
    white = kappa**2 * size
    plain: Array = white * inverse + (1.0 - white) * inverse @ prior @ inverse
    count, unknown = len(scores), n + _STATES * segments
    if count < 2 * unknown + 2:
        return plain
    S = long_run(scores, int(np.ceil(reach / block)))
    wide = _widening(2.0 * reach / (block * count)) ** 2 * kappa**2 * count / (count - unknown)
    honest: Array = inverse @ (wide * S + prior) @ inverse
    variance, least = np.diag(honest), np.diag(plain)
    grow = np.sqrt(np.maximum(1.0, least / np.where(variance > 0.0, variance, np.inf)))
    return honest * np.outer(grow, grow) if np.all(variance > 0.0) else plain


def _widening(share: float) -> float:
    """Return the factor of an interval whose long-run sum takes in this share of the run."""
    b = min(share, 1.0)
    return (1.96 + 2.9694 * b + 0.4160 * b**2 - 0.5324 * b**3) / 1.96
