"""Which way each thruster pushes, and which output drives which, as recordings show it.

Outputs may be swapped, propellers turn the other way. Two judges, who err about different things, say how likely each
way of wiring is. Linear responses of each speed to the forces (`offline.axis_responses`) know nothing of the vehicle;
they look at every set of signs. The joint filter knows all that is supposed of it, all axes at once and every sensor,
an autopilot that answers the motion, weight and righting moments: one pass with the inputs so wired says how likely
what was measured is. It looks at the wirings that the first has not ruled out.

The filter looks at stretches in which the inputs change most, each by itself, linearised about where a first few passes
with the file's wiring have come to: what is supposed may be far off, four times too light in heave, and follows no
wiring there, and none best of all. No model is right about all of a recording: what it lacks lasts for about half a
second, so that ten samples tell as much as one, and a stretch holds no more than `_NONSENSE` nats against any wiring.

Each thruster that is turned costs some, all of them at once no more than one, and a swap; a thruster of which linear
responses see nothing, for no axis that it moves shows its speed, costs more: one judge alone is fooled more easily.

Where both together find another surely likelier than the file's, for what it costs, they have decided; what linear
responses find likeliest takes the place of what both do where it is likelier by far, learned with. Else what linear
responses are sure of, and the few for which the data speak, be it by less than they cost, are learned with, pass after
pass, for what a swap does to 30 s of a vehicle that is not known may be small. The file's wiring is learned with, too,
and stays unless another is likelier by more than it costs; what both judges found likelier, for all that it costs, need
only be no less likely than `_STAYS`.

Thrusters are turned or their outputs swapped; none is moved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import combinations

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples
from towtank.identification.kalman.passes import first_passes, joint_fit, one_pass, settled
from towtank.identification.kalman.problem import JointFit, JointProblem
from towtank.identification.offline.axis_responses import axis_responses, likelihood_of
from towtank.recording.grids.stretches import cuts
from towtank.vehicle.thrusters.wiring import Wiring

__all__ = ["wiring_of"]

_TURN, _SWAP, _CHOICE = 6.0, 8.0, 3.0  # nats that a turned thruster costs, a swap, and the logarithm of their number
_UNSEEN = 25.0  # nats that a turned thruster costs more where linear responses do not see it
_FILE, _ALONE = 12.0, 20.0  # nats by which the file is likelier beforehand; by which one judge alone is sure
_STAYS = 5.0  # nats by which the file must be likelier, learned with, to stay where both judges found another
_SURE = 15.0  # nats by which both must find another likelier than the file's, for what it costs, to be believed at once
_NEAR = 10.0  # nats below what it costs that call for a second look
_SPEAK, _MOST = 1.0, 3  # nats by which data speak for a wiring that is learned with; as many at most
_PIECE, _PIECES = 10.0, 12  # s of a stretch; as many at most
_APART, _ALIKE = 0.05, 10.0  # s between two samples of a sensor that are looked at; so many tell as much as one
_NONSENSE = 10.0  # nats that a stretch holds against a wiring at most
_FIRST, _PASSES = 4, 10  # passes that find whereabouts the vehicle is, and the level of disturbance; that learn
_MANY = 12  # inputs, above which not every set of signs is tried
_LOOKED_AT, _BEHIND = 40, 40.0  # wirings that the filter looks at, at most, and nats behind the likeliest: no longer


def wiring_of(problem: JointProblem) -> Wiring:
    """Return how recordings have the inputs wired; nothing turned or swapped where they do not speak for it.

    Args:
        problem: as it would be learned from; of samples with other inputs than the first ones nothing is used.
    """
    first = problem.samples[0]
    samples = [each for each in problem.samples if each.commands == first.commands and np.array_equal(each.B, first.B)]
    inertia = np.diag(problem.vehicle.mass_matrix)
    pieces = _pieces(samples, inertia)
    if not pieces:
        return Wiring()
    responses = axis_responses(samples)
    forces = np.concatenate([each.input_force for each in samples])
    used = [int(k) for k in np.flatnonzero(first.B.any(axis=0) & (np.ptp(forces, axis=0) > 0.0))]
    seen = [k for k in used if first.B[[each.axis for each in responses], k].any()]
    ways = _signs(used)
    data, price = likelihood_of(ways, responses, first.B, inertia), _price(ways, used, seen)
    if first.commands:
        swaps = _swaps(ways[int(np.argmax(data - price))], first.B)
        data = np.append(data, likelihood_of(swaps, responses, first.B, inertia))
        price = np.append(price, _price(swaps, used, seen))
        ways += swaps
    price[0] = -_FILE
    found = data - price
    best = int(np.argmax(found))
    alone = [ways[best]] if found[best] > data[0] + _ALONE else []
    data[0] = max(data[0], found[best] - _ALONE)  # how far behind the file's is alone, it takes both to say
    rest = [k for k in np.argsort(price - data, kind="stable") if k and data[k] >= data[0] - _ALONE]
    few = _different(ways, [0, *rest[:_LOOKED_AT]], first.B, forces)  # the file's is always among them
    look, cost = _Look(problem.over(pieces)), dict(zip(ways, price.tolist(), strict=True))
    told = look.likeliest({ways[k]: float(data[k]) for k in few})
    judged = max(told, key=lambda way: told[way] - cost[way])
    if told[judged] - cost[judged] > told[Wiring()] + _SURE:
        gained = look.learned(ways[best]) - look.learned(judged) if ways[best] != judged else 0.0
        return ways[best] if gained > price[best] - cost[judged] + _ALONE else judged
    left = [way for way in told if way and told[way] > told[Wiring()] + _SPEAK][:_MOST]
    rivals = [*dict.fromkeys((*left, *alone))]
    return look.choice(dict(zip(rivals, _price(rivals, used, used), strict=True)), judged)  # sees what both have not


def _signs(used: Sequence[int]) -> list[Wiring]:
    """Return the ways to turn inputs, none turned first; those that are never used are left alone."""
    n = len(used)
    sizes = range(n + 1) if n <= _MANY else (0, 1, 2, n)
    return [Wiring(turned) for size in sizes for turned in combinations(used, size)]


def _swaps(first: Wiring, B: Array) -> list[Wiring]:
    """Return two outputs swapped, with none, some or the likeliest thrusters turned."""
    n = B.shape[1]
    few = [turned for size in range(3) for turned in combinations(range(n), size)]
    near = {tuple(sorted(set(first.turned) ^ set(turned))) for turned in few}
    return [
        Wiring(turned, pair)
        for pair in combinations(range(n), 2)
        for turned in sorted({*few, *near})
        if not np.allclose(B[:, pair[0]], B[:, pair[1]])
    ]


def _price(ways: Sequence[Wiring], used: Sequence[int], seen: Sequence[int]) -> Array:
    """Return what each way (h,) costs before any data [nats]; a swap more where there are many."""
    swap = _SWAP + _CHOICE * float(np.log(max(len(used) * (len(used) - 1) / 2.0, 1.0)))

    def cost(turned: set[int]) -> float:
        return _TURN * len(turned) + _UNSEEN * len(turned - {*seen})

    whole = _TURN if seen else _TURN + _UNSEEN
    turned = [min(cost({*way.turned}), whole + cost({*used} ^ {*way.turned})) for way in ways]
    return np.array(turned) + swap * np.array([bool(way.swapped) for way in ways])


def _different(ways: Sequence[Wiring], few: Sequence[int], B: Array, forces: Array) -> list[int]:
    """Return those of a few ways that do not make of the inputs what one before them makes."""
    shown = np.linalg.qr(forces).R.T  # two matrices make the same of these columns where they do of all inputs
    made = {tuple(np.round(ways[k].matrix(B) @ shown, 6).ravel() + 0.0): k for k in reversed(few)}
    return [*reversed(made.values())]


def _pieces(samples: Sequence[Samples], inertia: Array) -> list[Samples]:
    """Return the stretches to look at: those whose inputs would change the motion most, most first."""
    found = [each.stretch(a, b).thinned(_APART) for each in samples for a, b in cuts(each.t, _PIECE)]
    pushed = [np.std(each.input_force @ each.B.T / inertia, axis=0) if each.input_t.size else 0.0 for each in found]
    change = np.array([float(np.sum(each)) for each in pushed])
    return [found[k] for k in np.argsort(-change, kind="stable")[:_PIECES] if change[k] > 0.0]


class _Look:
    """What the joint filter says of ways of wiring, stretch by stretch."""

    def __init__(self, problem: JointProblem) -> None:
        """Args: problem: over the stretches, the inputs wired as the file has it."""
        self.problem = problem

    def likeliest(self, found: dict[Wiring, float]) -> dict[Wiring, float]:
        """Return the likeliest wirings by what was found and by the filter, likeliest first [nats]; and the file's.

        Stretch by stretch those are left out that have fallen far behind, or that those to come would not bring before
        the file's.
        """
        for k in range(stretches := len(self.problem.samples)):
            least = max(max(found.values()) - _BEHIND, found[Wiring()] - _NONSENSE * (stretches - k))
            found = {way: nats for way, nats in found.items() if nats >= least or not way}
            if len(found) > 1:
                ways = list(found)
                found = {way: found[way] + told for way, told in zip(ways, self._told(ways, k), strict=True)}
        return dict(sorted(found.items(), key=lambda each: -each[1]))

    def _told(self, ways: Sequence[Wiring], k: int) -> Array:
        """Return what stretch k says of each way (h,), beside the likeliest of them."""
        told = np.array([self._likelihood(way, k) for way in ways]) / _ALIKE
        return np.asarray(np.logaddexp(told, told.max() - _NONSENSE) - told.max())

    def _likelihood(self, way: Wiring, k: int) -> float:
        """Return the log likelihood of stretch k; very small where none can be computed."""
        coarse = replace(self.problem.settings, step=_APART)
        rewired = replace(self._rewired(way, slice(k, k + 1)), settings=coarse)
        found = float(one_pass(rewired, self._file.theta, self._file.levels, windows=1)[0].clock[0].log_likelihood)
        return found if np.isfinite(found) else -1e9

    def learned(self, way: Wiring) -> float:
        """Return how likely data are by a few passes with a wiring [nats], about where the file's has come to, or, if
        that is likelier, where all was supposed to be: the former may be far from what a right wiring comes to."""
        begins = ((self._file.theta, self._file.levels), None)
        return max(_nats(first_passes(self._rewired(way), _PASSES, since=each)) for each in begins)

    def choice(self, cost: Mapping[Wiring, float], judged: Wiring) -> Wiring:
        """Return the likeliest way, learned with: the file's, or one that is likelier by more than it costs [nats].

        All begin where the file's has come to. Those that come near it begin a second time where all was supposed to
        be, as the file's does, in the water that it finds. The likelier counts. Passes come farther with one way or
        another by chance, too: what takes the file's place must be likelier where both are learned as a log is.

        Args:
            cost: of each of a few ways. judged: what both judges found, which has paid.
        """
        first, mean, found = self._file, self.problem.prior.mean, dict[Wiring, float]()
        for way in (Wiring(), *cost) if cost else ():
            found[way] = _nats(first_passes(self._rewired(way), _PASSES, since=(first.theta, first.levels)))
        least = {way: -_STAYS if way == judged else nats for way, nats in cost.items()}
        near = [way for way in cost if found[way] > found[Wiring()] + least[way] - _NEAR]
        if near:
            whole = joint_fit(self.problem, since=(mean, first.levels))
            found[Wiring()] = max(found[Wiring()], _nats(whole))
            settings = replace(self.problem.settings, wave_period=whole.wave_period)
            again = {way: replace(self._rewired(way), settings=settings) for way in near}
            found |= {way: max(found[way], _nats(settled(each, mean, whole.levels))) for way, each in again.items()}
        likelier = [way for way in near if found[way] > found[Wiring()] + least[way]]
        last = {way: _nats(joint_fit(self._rewired(way))) for way in (Wiring(), *likelier)} if likelier else {}
        likelier = [way for way in likelier if last[way] > last[Wiring()] + min(least[way], 0.0)]
        return max(likelier, key=lambda way: found[way] - cost[way], default=Wiring())

    def _rewired(self, way: Wiring, only: slice = slice(None)) -> JointProblem:
        samples = [replace(each, B=np.ascontiguousarray(way.matrix(each.B))) for each in self.problem.samples[only]]
        return self.problem.over(samples)

    @cached_property
    def _file(self) -> JointFit:
        """Where a first few passes have the vehicle, wired as the file says, and how much noise and disturbance."""
        return first_passes(self.problem, _FIRST)


def _nats(fit: JointFit) -> float:
    return fit.likelihood / _ALIKE if np.isfinite(fit.likelihood) else -1e9
