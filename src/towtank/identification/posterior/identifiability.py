"""What a run determines: which coefficients, which only together, and of which it says nothing.

All is read from the Fisher information of the run over all free coefficients at once, in relative coordinates. A
coefficient is determined where its deviation, all others unknown, is below a quarter of its value; where somebody named
the coefficients, so that there is no choosing, below half of it: the interval of 95 % excludes nothing. The others are
given up one by one, each with its reason, and the rest is judged anew: first those of which nothing is known even if
all else were; then a common scale of forces that nothing fixes; then pairs that only appear together, of which the one
that is known less gives way.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.identification.posterior import wording as words
from towtank.identification.posterior.statistics import alone, along, correlations, deviations, pair, relative, weakest
from towtank.identification.posterior.wording import Role, phrase, role

__all__ = ["DETECTED", "DETERMINED", "Criteria", "Hold", "Identifiability", "excitation", "excitation_words"]

State = Literal["determined", "merged", "undetermined"]
Hold = Literal["", "zero", "value"]
DETERMINED = 0.25  # deviation below which a coefficient is worth choosing: four deviations from nothing
DETECTED = 0.5  # deviation below which it is different from nothing
_FELT = 0.10  # deviation, all else known, from which the data does speak of a coefficient
_ALIKE = 0.95  # correlation
_LIKELY = 0.9  # correlation from which a pair is examined
_LIKE = 0.7  # correlation that does between the two damping terms of one axis
_GIVES_WAY = {"gain": 4, "other": 4, "constant": 3, "coupling": 2, "lag": 1}  # before those that make up the vehicle


@dataclass(frozen=True, eq=False)
class Criteria:
    """How a run is judged.

    Attributes:
        speeds: (6, 2) root mean square and largest speed of each axis in the run [m/s, rad/s], for the sentences.
        yielding: names that give way to their like, whichever is known less.
        enough: relative deviation below which a coefficient is determined.
    """

    speeds: Array | None = None
    yielding: Collection[str] = ()
    enough: float = DETERMINED


@dataclass(frozen=True)
class Finding:
    """What the run says of one coefficient. Deviations are relative: 0.04 is 4 %.

    Attributes:
        state: "determined"; "merged": known only together with `partner`, for which it stands if that is held, or the
            other way round; "undetermined".
        std: with all others unknown. conditional: if all others were known. given: with what is held held, NaN if held.
        hold: "" free, "zero" or "value" (the vehicle's): what to do with it.
        reason: one sentence.
    """

    name: str
    state: State
    std: float
    conditional: float
    given: float
    hold: Hold
    partner: str | None
    reason: str

    @property
    def rough(self) -> bool:
        """Whether it is not determined, and yet further than its deviation from nothing."""
        return self.state == "undetermined" and self.std < 1.0


@dataclass(frozen=True)
class Combination:
    """A combination that is known where its members are not: sum of weight times relative change, and its deviation."""

    names: tuple[str, ...]
    weights: tuple[float, ...]
    std: float
    text: str


@dataclass(frozen=True)
class Identifiability:
    """Findings in the order of the names, and the combinations that are known instead."""

    findings: tuple[Finding, ...]
    combinations: tuple[Combination, ...]

    def __getitem__(self, name: str) -> Finding:
        for finding in self.findings:
            if finding.name == name:
                return finding
        raise InputError(f'"{name}" was not free{nearest(name, [each.name for each in self.findings])}')

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the coefficients that are determined."""
        return tuple(each.name for each in self.findings if each.state == "determined")

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the coefficients to estimate: all that are not held."""
        return tuple(each.name for each in self.findings if not each.hold)

    @property
    def held(self) -> Mapping[str, Hold]:
        """Which coefficients to hold, and at what: "zero" or the vehicle's "value"."""
        return {each.name: each.hold for each in self.findings if each.hold}

    @property
    def reasons(self) -> Mapping[str, str]:
        """Why the others are not determined."""
        return {each.name: each.reason for each in self.findings if each.state != "determined"}


def identifiability(
    names: Sequence[str],
    theta: Array,
    information: Array,
    *,
    logarithmic: Sequence[bool],
    size: Array | None = None,
    prior: Array | None = None,
    criteria: Criteria | None = None,
) -> Identifiability:
    """Judge a run by its information.

    Args:
        names: coefficients, `delay`, `lag`, `gain_<thruster>` (n,).
        theta: their coordinates (n,): ln of total inertia, of -damping, of a gain where `logarithmic`, else themselves.
        information: Fisher information (n, n) of the run in these coordinates; may be singular.
        size: (n,) what is 100 % of a coordinate that is no logarithm; default |theta|, 1 where that is 0.
        prior: information (n, n) known beforehand, in the same coordinates.

    Raises:
        InputError: shapes that do not fit together.
    """
    n = len(names)
    theta, log = np.asarray(theta, dtype=np.float64), np.asarray(logarithmic, dtype=np.bool_)
    shapes = (theta.shape, log.shape, np.shape(information), (n, n) if prior is None else np.shape(prior))
    if shapes != ((n,), (n,), (n, n), (n, n)):
        raise InputError(f"identifiability: {n} names, found arrays of shapes {shapes}")
    given = np.abs(theta) if size is None else np.abs(np.asarray(size, dtype=np.float64))
    unit = np.where(log, 1.0, np.where((given > 0.0) & np.isfinite(given), given, 1.0))
    A = relative(information, unit, prior)
    growth = np.where(log, 1.0, np.nan_to_num(theta / unit))
    criteria = criteria or Criteria()
    verdict = _Judge(tuple(names), A, growth, _magnitudes(theta, log), criteria).verdict()
    if prior is None:
        return verdict
    own = deviations(relative(information, unit))
    return replace(
        verdict,
        findings=tuple(
            replace(each, reason=words.from_prior(each.name, each.std, float(s)))
            if each.state == "determined" and not s < criteria.enough
            else each
            for each, s in zip(verdict.findings, own, strict=True)
        ),
    )


def _magnitudes(theta: Array, log: NDArray[np.bool_]) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.where(log, np.exp(np.where(log, theta, 0.0)), np.abs(theta))


class _GivenUp(NamedTuple):
    state: State
    hold: Hold
    partner: str | None
    reason: str


@dataclass
class _Judge:
    """The coefficients still free, and what was found of the others."""

    names: tuple[str, ...]
    A: Array
    growth: Array  # relative change of each coordinate when the unit of force grows
    magnitude: Array
    criteria: Criteria
    free: list[int] = field(default_factory=list)
    given_up: dict[int, _GivenUp] = field(default_factory=dict)
    relatives: dict[int, tuple[str | None, str]] = field(default_factory=dict)  # partner and reason of one kept
    stands_for: set[int] = field(default_factory=set)  # of two damping terms, the one that is kept
    ratios: list[tuple[int, int]] = field(default_factory=list)  # one of a group, and the one that fixes its scale
    combinations: list[Combination] = field(default_factory=list)

    def verdict(self) -> Identifiability:
        n = len(self.names)
        self.roles = [role(name) for name in self.names]
        self.free = list(range(n))
        whole, single = deviations(self.A), alone(self.A)
        while self.free and not (self._now() < self.criteria.enough).all():
            if not (self._damping(single) or self._silent(single) or self._scale() or self._pair(single)):
                self._give_up_one()
        left = np.full(n, np.nan)
        left[self.free] = self._now()
        for i, scale in self.ratios:
            if i in self.free and not whole[i] < self.criteria.enough:
                names = (self.names[i], self.names[scale])
                self.combinations.append(Combination(names, (1.0, -1.0), float(left[i]), words.ratio_known(*names)))
        return Identifiability(
            tuple(self._finding(i, float(whole[i]), float(single[i]), float(left[i])) for i in range(n)),
            tuple(self.combinations),
        )

    def _now(self) -> Array:
        return deviations(self.A[np.ix_(self.free, self.free)])

    def _finding(self, i: int, std: float, single: float, left: float) -> Finding:
        name = self.names[i]
        if i in self.given_up:
            lost = self.given_up[i]
            return Finding(name, lost.state, std, single, left, lost.hold, lost.partner, lost.reason)
        if std < self.criteria.enough and i not in self.stands_for:
            return Finding(name, "determined", std, single, left, "", None, words.determined(name, std))
        partner, why = self.relatives.get(i, (None, words.rests_on_held(name, left)))
        return Finding(name, "merged", std, single, left, "", partner, why)

    def _drop(self, i: int, state: State, hold: Hold, partner: str | None, reason: str) -> None:
        self.free.remove(i)
        self.given_up[i] = _GivenUp(state, hold, partner, reason)

    def _silent(self, single: Array) -> bool:
        """Give up those that would stay open even if all else were known."""
        silent = [i for i in self.free if not single[i] < self.criteria.enough]
        for i in silent:
            reason = words.silent(self.names[i], self.roles[i], float(single[i]), self.criteria.speeds)
            self._drop(i, "undetermined", "value", None, reason)
        return bool(silent)

    def _scale(self) -> bool:
        """Hold one coefficient where all of a group may grow together: the vehicle with its gains, or one axis."""
        scaling = [i for i in self.free if self.roles[i].scales]
        axes = [[i for i in scaling if self.roles[i].row == axis] for axis in range(6)]
        groups = [(-1, scaling), *((axis, group) for axis, group in enumerate(axes) if group != scaling)]
        open_ = {i for i, std in zip(self.free, self._now(), strict=True) if not std < self.criteria.enough}
        for axis, group in groups:
            inertias = [i for i in group if self.roles[i].kind == "inertia"]
            if len(group) < 2 or not inertias or not open_.issuperset(inertias):
                continue
            direction = np.zeros(len(self.names))
            direction[group] = self.growth[group]
            common = along(self.A, direction)
            if common < self.criteria.enough:
                continue
            gains = [i for i in group if self.roles[i].kind == "gain"]
            scale = min(gains or inertias, key=lambda i: (self.A[i, i] <= 0.0, i))
            self.ratios += [(i, scale) for i in group if i != scale]
            for i in group:
                held = self.names[scale]
                self.relatives[i] = (held, words.ratio(self.names[i], held, axis, common))
            reason = words.scale_held(self.names[scale], axis, common, bool(gains))
            self._drop(scale, "merged", "value", None, reason)
            return True
        return False

    def _damping(self, single: Array) -> bool:
        """Let one of the two damping terms of an axis stand for both, where these are only known as a sum."""
        now = dict(zip(self.free, self._now(), strict=True))
        for place, i in enumerate(self.free):
            for j in self.free[place + 1 :]:
                if not _mates(self.roles[i], self.roles[j]) or max(now[i], now[j]) < self.criteria.enough:
                    continue
                I2 = self._pair_information(i, j)
                pair = self._pair_words(i, j, I2, single)
                if _correlation(I2) < -_LIKE and pair.known.std < self.criteria.enough:
                    self._merge(i, j, pair, single, "zero")
                    return True
        return False

    def _pair(self, single: Array) -> bool:
        """Let one of the two give way that are the most alike."""
        now = dict(zip(self.free, self._now(), strict=True))
        likely = np.abs(correlations(self.A[np.ix_(self.free, self.free)])) > _LIKELY
        best: tuple[float, int, int, Array] | None = None
        for place, other in zip(*np.nonzero(np.triu(likely, 1)), strict=True):
            i, j = self.free[place], self.free[other]
            if max(now[i], now[j]) < self.criteria.enough or not min(single[i], single[j]) < _FELT:
                continue
            I2 = self._pair_information(i, j)
            r = abs(_correlation(I2))
            if r > _ALIKE and (best is None or r > best[0]):
                best = (r, i, j, I2)
        if best is None:
            return False
        _, i, j, I2 = best
        sum_ = _mates(self.roles[i], self.roles[j]) and _correlation(I2) < 0.0
        self._merge(i, j, self._pair_words(i, j, I2, single), single, "zero" if sum_ else "value")
        return True

    def _pair_words(self, i: int, j: int, I2: Array, single: Array) -> words.PairWords:
        loser, winner = (i, j) if self._yields(i, j, single) else (j, i)
        return words.pair_words(
            words.Pair(
                self.names[winner],
                self.names[loser],
                self.roles[winner],
                self.roles[loser],
                (float(self.magnitude[winner]), float(self.magnitude[loser])),
                I2 if winner == i else I2[::-1, ::-1],
                self.criteria.speeds,
            )
        )

    def _merge(self, i: int, j: int, both: words.PairWords, single: Array, hold: Hold) -> None:
        loser, winner = (i, j) if self._yields(i, j, single) else (j, i)
        names = (self.names[winner], self.names[loser])
        self.combinations.append(Combination(names, *both.known))
        self._drop(loser, "merged", hold, names[0], both.loser)
        self.relatives[winner] = (names[1], both.winner)
        if hold == "zero":
            # it takes over the other's part, so that its deviation is now a smaller share of it
            self.stands_for.add(winner)
            share = min(max(both.known.weights[0], 0.1), 1.0)
            self.A[winner] /= share
            self.A[:, winner] /= share
            single[winner] *= share

    def _pair_information(self, i: int, j: int) -> Array:
        rows = self.free
        return pair(self.A[np.ix_(rows, rows)], rows.index(i), rows.index(j))

    def _yields(self, i: int, j: int, single: Array) -> bool:
        """Whether i gives way to j: the one that is no core of the model, else the one that is known less."""
        a, b = ((_GIVES_WAY.get(self.roles[k].kind, 0), self.names[k] in self.criteria.yielding) for k in (i, j))
        return a > b if a != b else bool(single[i] > single[j])

    def _give_up_one(self) -> None:
        """Give up the least of those that are only known together with several others, or simply not well enough."""
        now = self._now()
        members = weakest(self.A, self.free)
        open_ = [i for i, std in zip(self.free, now, strict=True) if not std < self.criteria.enough]
        among = [i for i in open_ if i in members] or open_
        single = alone(self.A)
        last = max(among, key=lambda i: (_GIVES_WAY.get(self.roles[i].kind, 0), single[i], -i))
        std = float(now[self.free.index(last)])
        others = [self.names[i] for i in members if i != last] if last in members else []
        self._drop(last, "undetermined", "value", None, words.entangled(self.names[last], others, std))


def _mates(a: Role, b: Role) -> bool:
    """Whether two are the linear and the quadratic damping of one axis."""
    return {a.kind, b.kind} == {"linear", "quadratic"} and a.row == b.row


def _correlation(I2: Array) -> float:
    size = float(np.sqrt(I2[0, 0] * I2[1, 1]))
    return -float(I2[0, 1]) / size if size > 0.0 else 0.0


def excitation(names: Sequence[str], covariance: Array) -> dict[str, float]:
    """Return to how many percent a run makes each coefficient known, from a relative covariance (n, n); inf if not."""
    with np.errstate(invalid="ignore"):
        std = np.sqrt(np.diag(np.asarray(covariance, dtype=np.float64)))
    return {name: 100.0 * float(s) if np.isfinite(s) else np.inf for name, s in zip(names, std, strict=True)}


def excitation_words(known: Mapping[str, float]) -> tuple[str, ...]:
    """Return a line for each: "surge drag will be known to 4 %"."""
    return tuple(words.will_be_known(phrase(name, known), value) for name, value in known.items())
