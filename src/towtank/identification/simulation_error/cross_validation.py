"""Recordings that models run over freely, and how near they come where they have not been.

What a fit claims about the data that it was fitted to says little. So the recordings are cut into windows, the windows
are dealt into folds one after the other, and the windows of each fold are run over with coefficients fitted to all the
others, from initial states of their own: nothing else is fitted there. Two models are compared by the square errors of
their runs over the same windows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.model.measurements import SPEEDS, shown_axes
from towtank.identification.simulation_error.fit import OutputErrorFit, fit_output_error
from towtank.identification.simulation_error.segments import CandidateModel, Knowledge
from towtank.identification.simulation_error.trajectory import STEP
from towtank.recording.axes import CHANNELS_OF
from towtank.recording.grids.stretches import Stretch, cuts
from towtank.recording.standard import ACCELERATIONS, MEASURED
from towtank.vehicle import Vehicle
from towtank.vehicle.names import ROWS

__all__ = ["ErrorReduction", "FreeRuns", "columns_of", "error_reduction", "fit_percent"]

_FAILED, _FLOOR = 10.0, 0.1
_RUN, _POSED = 5.0, 60.0  # s: length of a run; and where a pose is run over, which remembers how it began
_SHORTEST, _ROWS = 2.5, 40  # s, and rows, of a window
_WINDOWS = 8  # usual number of windows, where the recordings are short
_FEWEST = 4  # windows, without which nothing is compared
_FOLDS = 4
_MOST_ROWS = 12_000  # or steps, that models run over; of more, windows spread evenly are looked at
_UPRIGHT = 0.1  # rad, deviation of an attitude that is not measured, where a run begins
_BEGIN = 2  # rows that it is put into
_SURE = 1e9  # 1/deviation^2 of what is held in a free run
_ITERATIONS, _AGAIN, _STATES = 30, 20, 8
_CLAIMED = 1e-6  # of the prior's deviation, which no recording can promise


@dataclass(frozen=True)
class ErrorReduction:
    """Share of the square error that one model saves beside another: mean over the windows, and its deviation."""

    mean: float
    std: float

    def beyond(self, deviations: float, least: float) -> bool:
        """Whether it is no accident, and worth something."""
        return bool(self.mean > max(deviations * self.std, least))


def error_reduction(new: Array, old: Array, columns: Sequence[int]) -> ErrorReduction:
    """Compare errors (w, 18) of two models over the same windows in some columns, all of them alike.

    Of each window the logarithm of the ratio counts, with a tenth of the usual error put beside both: no window alone
    decides, and none in which nothing happens. A run that went nowhere (inf) counts as ten times as bad as usual; where
    all did, the reduction is infinite.
    """
    new, old = np.array(new[:, list(columns)]), np.array(old[:, list(columns)])
    if not np.isfinite(new).any():
        return ErrorReduction(-np.inf, 0.0)
    if not np.isfinite(old).any():
        return ErrorReduction(np.inf, 0.0)
    usual = np.full(len(columns), np.nan)
    for j in range(len(columns)):
        both = np.concatenate([new[:, j], old[:, j]])
        if (fine := both[np.isfinite(both)]).size:
            for errors in (new[:, j], old[:, j]):
                errors[np.isposinf(errors)] = _FAILED * float(np.mean(fine))
        else:
            new[:, j] = old[:, j] = np.nan  # measured nowhere
        if (known := old[~np.isnan(old[:, j]), j]).size:
            usual[j] = float(np.mean(known))
    excited = np.flatnonzero(np.nan_to_num(usual) > 0.0)
    least = _FLOOR * usual[excited]
    share = np.log(old[:, excited] + least) - np.log(new[:, excited] + least)
    rows = share[~np.isnan(share).all(axis=1)]
    if not rows.size:
        return ErrorReduction(-np.inf, 0.0)
    each = np.nansum(rows, axis=1) / np.sum(~np.isnan(rows), axis=1)
    mean = float(each.mean())
    std = float(each.std(ddof=1) / np.sqrt(each.size)) if each.size > 1 else np.inf
    return ErrorReduction(1.0 - float(np.exp(-mean)), std * float(np.exp(-mean)))


def fit_percent(errors: Array, spread: Array, columns: Sequence[int]) -> float:
    """Return the mean of 100 (1 - error / deviation) [%] over the columns that are measured; NaN where none is."""
    out = []
    for j in columns:
        known = errors[~np.isnan(errors[:, j]), j]
        if known.size and spread[j] > 0.0:
            out.append(100.0 * (1.0 - np.sqrt(np.mean(known) / spread[j])))
    return float(np.mean(out)) if out else float("nan")


def columns_of(names: Sequence[str]) -> tuple[int, ...]:
    """Return the columns that show the axes whose coefficients are free, but for the specific force."""
    axes = set()
    for name in names:
        if name[0] in ROWS and name[1:2] == "_":
            axes.add(ROWS.index(name[0]))
        elif name.startswith("BG_"):
            axes |= {3, 4}
        elif name == "W_minus_B":
            axes.add(2)
    shown = {name for i, channels in enumerate(CHANNELS_OF.values()) if i in axes for name in channels}
    return tuple(j for j, name in enumerate(MEASURED) if name in shown and name not in ACCELERATIONS)


@dataclass(frozen=True, eq=False)
class FreeRuns:
    """Recordings, windows of them, and what is known before them.

    Attributes:
        samples: of each recording, or of stretches of it where there is too much. noise: (18,).
        attitude: of each, roll and pitch (n, 2) that a run may begin with where none is measured, NaN where not known.
        segment: length of a run [s]. thinned: whether there was too much.
        prior: what is known beforehand of the coefficients, mean (n,) and information (n, n).
    """

    vehicle: Vehicle
    samples: tuple[Samples, ...]
    attitude: tuple[Array, ...]
    noise: Array
    segment: float
    windows: tuple[Stretch, ...]
    thinned: bool
    prior: Knowledge

    @classmethod
    def over(
        cls,
        vehicle: Vehicle,
        samples: Sequence[Samples],
        noise: Array,
        names: Sequence[str],
        prior: Knowledge,
        attitude: Sequence[Array] | None = None,
    ) -> FreeRuns:
        """Prepare recordings for coefficients of these names; what says nothing of their axes is left out."""
        measured = np.any([each.measured for each in samples], axis=0)
        left = _informative(columns_of(names), measured)
        rows_of = [np.flatnonzero(np.isfinite(each.values[:, list(left)]).any(axis=1)) for each in samples]
        tilting = set(columns_of(names)) - {5, 11}  # yaw alone does not ask which way is up
        absent = [np.full((len(each), 2), np.nan) for each in samples]
        angles = list(attitude) if attitude is not None and tilting else absent
        segment = _POSED if 0 in left else _RUN
        stamps = [each.t[rows] for each, rows in zip(samples, rows_of, strict=True)]
        cost = sum(max(t.size, round(float(t[-1] - t[0]) / STEP)) for t in stamps if t.size)
        pieces = [(k, rows) for k, rows in enumerate(rows_of)]
        if cost > _MOST_ROWS:
            parts = [(k, rows_of[k][a:b]) for k, t in enumerate(stamps) for a, b in cuts(t, segment)]
            some = np.linspace(0, len(parts) - 1, max(1, len(parts) * _MOST_ROWS // cost)).astype(np.int64)
            pieces = [parts[i] for i in np.unique(some)]
        angles = [angles[k][rows] for k, rows in pieces]
        kept = [samples[k].only(rows, left) for k, rows in pieces]
        if cost > _MOST_ROWS:
            kept = [each.stretch(0, len(each)) for each in kept]
        total = sum(each.duration for each in kept)
        step = total / max(sum(len(each) for each in kept), 1)
        length = float(np.clip(total / _WINDOWS, max(_SHORTEST, _ROWS * step), max(segment, _ROWS * step)))
        windows = tuple(Stretch(k, a, b) for k, each in enumerate(kept) for a, b in cuts(each.t, length))
        noise = np.array(noise)
        if not measured[3:5].any():
            noise[3:5] = _UPRIGHT
        return cls(vehicle, tuple(kept), tuple(angles), noise, segment, windows, cost > _MOST_ROWS, prior)

    @property
    def shown(self) -> NDArray[np.bool_]:
        """Axes (6,) whose motion a column shows that is run over."""
        return shown_axes(np.any([each.measured for each in self.samples], axis=0))

    @property
    def comparable(self) -> bool:
        """Whether there are windows enough to compare models over."""
        return len(self.windows) >= _FEWEST

    def fit(self, model: CandidateModel, *, without: Sequence[int] = ()) -> OutputErrorFit | None:
        """Fit free runs to everything but the windows `without`, from the model; None where that cannot be done.

        Nor where the runs hang on a coefficient by a hair, as those of a vehicle that swings or tumbles may: then the
        derivatives say nothing of the coefficient, and the deviation that follows from them is absurdly small.
        """
        most = _AGAIN if without else _ITERATIONS
        fit = self._fitted(self._rest(without), model, self.prior, most)
        if fit is None or not (np.isfinite(fit.theta).all() and np.isfinite(fit.cost)):
            return None
        if not np.isfinite(fit.covariance).all():
            return None
        possible = _CLAIMED**2 / np.diag(self.prior[1])
        return fit if (np.diag(fit.covariance) > possible).all() else None

    def held(self, model: CandidateModel) -> OutputErrorFit | None:
        """Return runs over everything by the model as it is, from initial states of their own; None where they fail."""
        return self._as_it_is(self._rest(()), model)

    def errors(self, model: CandidateModel, windows: Sequence[int] | None = None) -> Array:
        """Return the mean squares (w, 18) of what free runs over each window miss [of the noise]; inf where one fails.

        NaN stands for what is not measured there.
        """
        chosen = range(len(self.windows)) if windows is None else windows
        out = np.full((len(chosen), N_MEASURED), np.inf)
        for row, w in enumerate(chosen):
            fit = self._as_it_is([self._piece(self.windows[w])], model)
            if fit is not None and np.isfinite(fit.cost):
                out[row] = (fit.residual_std / self.noise) ** 2
        return out

    @property
    def folds(self) -> list[list[int]]:
        """The windows dealt into folds, neighbours together."""
        return [fold.tolist() for fold in np.array_split(np.arange(len(self.windows)), min(_FOLDS, len(self.windows)))]

    def spread(self) -> Array:
        """Return the variance (18,) of each column over all windows [of the noise]."""
        rows = np.concatenate([self.samples[w.recording].values[w.first : w.last] for w in self.windows])
        out = np.full(N_MEASURED, np.nan)
        for j in range(N_MEASURED):
            known = rows[np.isfinite(rows[:, j]), j]
            if known.size:
                out[j] = np.var(known) / self.noise[j] ** 2
        return out

    def _rest(self, without: Sequence[int]) -> list[Samples]:
        out = []
        for k, each in enumerate(self.samples):
            left = np.ones(len(each), dtype=np.bool_)
            for window in (self.windows[w] for w in without):
                if window.recording == k:
                    left[window.first : window.last] = False
            edges = np.flatnonzero(np.diff(np.concatenate([[False], left, [False]]).astype(np.int64)))
            for first, last in edges.reshape(-1, 2):
                pieces = [Stretch(k, first + a, first + b) for a, b in cuts(each.t[first:last], self.segment)]
                out += [self._piece(piece) for piece in pieces]
        return out

    def _piece(self, window: Stretch) -> Samples:
        """Return a stretch of a recording, with the attitude that it begins with where it measures none."""
        piece = self.samples[window.recording].stretch(window.first, window.last)
        angles = self.attitude[window.recording][window.first : window.first + _BEGIN]
        if not np.isfinite(angles).all():
            return piece
        values = np.array(piece.values)
        values[: len(angles), 3:5] = angles
        return replace(piece, values=values)

    def _as_it_is(self, samples: Sequence[Samples], model: CandidateModel) -> OutputErrorFit | None:
        """Return runs by the model's coefficients, of which nothing but the initial states is fitted."""
        exactly = (np.array(model.theta), _SURE * np.eye(len(model.free)))
        return self._fitted(samples, model, exactly, _STATES)

    def _fitted(
        self, samples: Sequence[Samples], model: CandidateModel, prior: Knowledge, iterations: int
    ) -> OutputErrorFit | None:
        try:
            return fit_output_error(samples, model, self.noise, prior=prior, iterations=iterations)
        except (InputError, np.linalg.LinAlgError):
            return None


def _informative(columns: Sequence[int], measured: Array) -> tuple[int, ...]:
    """Return the columns to run over: what else is measured is not modelled, and would spoil what is.

    The attitude stays. Positions, which add up every error of the speeds, are for axes without a measured speed. They
    hang on the whole pose, and specific force, which hangs on everything, is not run over where there is anything else.
    """
    axes = [j - 6 for j in columns if 6 <= j < 12]
    speeds = {i: next((3 * s + i for s in SPEEDS if i < 3 and measured[3 * s + i]), 6 + i) for i in axes}
    chosen = {j for j in speeds.values() if measured[j]} | {3, 4, 5}
    if any(i < 3 and not measured[speeds[i]] for i in axes):
        chosen |= {0, 1, 2}
    if any(i >= 3 and not measured[6 + i] for i in axes):
        chosen |= {9, 10, 11}
    informative = tuple(sorted(j for j in chosen if measured[j]))
    return informative or tuple(int(j) for j in np.flatnonzero(measured))
