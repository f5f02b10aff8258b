"""Detection of a change of the vehicle: filters split off time and again, each free to change at that moment.

Every half second a filter is split off the first one, with inertia, drag, weight, righting moment, trim and, where
commands are known, the gains of the thrusters widened by what a payload or a fouled thruster would do to them, as far
as they are identified by then. What its samples say by themselves (`changes.evidence`) is the evidence of a change at
that moment, of any parts. A change is one that has an evidence beyond `_SURE` twice in a row, and of which it is clear
whether body or thruster is to blame. Then the filter that saw it goes on in place of the first one, informed of what
has not changed, so that nothing is learned twice. The moment is sought in steps of 0.1 s, by replay: a filter that
began before the change has seen both vehicles, and blames whatever bends most easily. Without motion a split filter
learns nothing, its evidence stays zero, and the first filter, whose coefficients do not walk, waits as it is. What was
known before the change, widened by it, becomes the prior of what follows.

Water that moves otherwise than before, in waves or another current, looks like a vehicle that changes, time and again.
Where a sensor sees the ground, so that a filter can tell, such water that began with a change or earlier is weighed
against it, and believed where it leads clearly; what leads by less is waited on for a while, and then called a change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.changes.branch import (
    Branch,
    Kept,
    Recent,
    Running,
    copied,
    definite,
    fused,
    inform,
    split_later,
    split_off,
    with_coordinates,
    without_change_of,
)
from towtank.identification.changes.events import Change, ChangeLog, OtherWater, Recognised
from towtank.identification.changes.evidence import Overdispersion
from towtank.identification.changes.hypotheses import (
    ConfigurationMatch,
    Hypothesis,
    Known,
    Verdict,
    hypotheses,
    judged,
    known_as,
    likeness,
    steps_of,
)
from towtank.identification.changes.water import Waters
from towtank.identification.data.samples import Buffer, Samples
from towtank.identification.kalman.state import coefficient_std
from towtank.identification.model.parameters import GAIN_PREFIX, IN_GAIN, FreeParameters
from towtank.identification.model.prior import Prior
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["ChangeTracker"]

_EVERY, _LIVES = 0.5, 3.0  # s: a filter is split off so often, and lives for so long;
_OLD_ONE, _LIVES_LONG = 4, 8.0  # every so many-th lives longer [s], for what shows slowly
_YOUNGEST = 0.4  # s of age from which a filter counts
_CHECKED = 0.25  # s from one check of the evidence to the next
_SURE = 11.0  # log Bayes factor of a change; Ville's inequality alone: one false alarm in 8 h
_CLEARLY = 20.0  # log odds of other water against a change, as of waves in a log
_CLEAR, _WAITS = 5.0, 3.0  # log odds between body and thrusters, and for how long they are waited for [s]
_FINELY, _EARLIER, _LATER = 0.1, 0.5, 1.0  # s: the beginning is sought so finely, so far about the best one,
_PERSISTS, _AGED = 0.4, 0.2  # s: when it has lasted so long, if thrusters may be to blame, and so long ago at least
_AGAIN = 2  # checks in a row
_KNOWN = 0.5  # times the deviation of before: so much has become known
_TRUSTED = 20.0  # s after a re-estimation was requested for which a change is accepted
_COMPARED = 15.0  # s for which a change is compared with known configurations
_TAKEN, _DROPPED = 0.98, 0.3  # probability at which a known configuration is taken as prior, and given up
_LEAST_MOTION = 15.0  # s of motion from which on changes are looked for


class ChangeDetector:
    """The branches of one filter, and what they show.

    Args:
        vehicle: what is known. buffer: an empty one, of the inputs that are used; commands separate thrusters.
        known: configurations by name. overdispersion: of increments, learned along.

    Attributes:
        requested: when a re-estimation was requested [s]: where a coefficient has just become known far from where the
            motion is linearised, an axis that begins to move surprises as a change does. What is seen again after that
            is accepted.
        likely: configurations, with their probabilities, since the last change.
        suspect: a change that is not yet decided about: the filter that saw it, how often in a row, since when [s].
    """

    def __init__(
        self, vehicle: Vehicle, buffer: Buffer, known: Mapping[str, Vehicle], overdispersion: Overdispersion
    ) -> None:
        self.vehicle, self.known = vehicle, dict(known)
        self._rows = buffer
        self.overdispersion = overdispersion
        self._recent = Recent(_LIVES_LONG + _EVERY)
        self._branches: list[Branch] = []
        self._batch: Samples | None = None  # rows that filters catch up with, one after the other
        self._waiting: list[Branch] = []
        self._last = -np.inf
        self._hypotheses: tuple[Hypothesis, ...] = ()
        self._steps = np.empty(0)
        self._wide: Prior | None = None
        self._next_split = self._next_check = -np.inf
        self._count = 0
        self.suspect: tuple[Branch, int, float] | None = None
        self._waters: Waters | None = None  # that may be meant by what is suspected
        self._matching: ConfigurationMatch | None = None
        self.requested = -np.inf
        self.likely: dict[str, float] = {}

    def restart(self, *, matching: bool = False) -> None:
        """Forget all branches: the first filter has begun anew; a configuration match too, but with `matching`."""
        if matching and self._matching is not None:
            self._catch_up()
        for each in (self._branches, self._rows, self._recent, self._waiting):
            each.clear()
        self._batch = self.suspect = self._waters = None
        self._last = self._next_split = self._next_check = -np.inf
        self._count, self._wide = 0, None  # as one that goes on from a checkpoint
        if not matching:
            self._matching = None

    def take_input(self, t: float, force: Array) -> None:
        """Take the forces (m,) asked for from t [s] on."""
        if self._branches or self._matching is not None:
            self._rows.add_input(t, force)

    def take_row(self, t: float, z: Array) -> None:
        """Take the row z (18,) of time t [s]."""
        if self._branches or self._matching is not None:
            self._rows.add_row(t, z)

    def step(self, t: float, running: Running) -> Change | Recognised | OtherWater | None:
        """Do what is due at t [s], a little with every row: let branches catch up, judge them, split off the next."""
        span, self._last = t - self._last, t
        if self._waiting:
            share = min(1.0, max(span / _CHECKED, 0.0))
            for _ in range(max(1, math.ceil(2.0 * share * len(self._branches)))):
                if self._waiting:
                    self._serve(self._waiting.pop())
            if self._waiting:
                return None
            change = self._judge(t, running)
            if change is not None:
                return change
            return self._compare(t, self._matching, running) if self._matching is not None else None
        if t >= self._next_check:
            self._next_check = t + _CHECKED
            self._batch = self._recent.add(self._rows)
            self._waiting = [branch for branch in self._all if branch.healthy]
            if t >= self._next_split:
                self._split(t, running)
        return None

    # -- inside

    @property
    def _all(self) -> list[Branch]:
        return self._branches if self._matching is None else [*self._branches, self._matching.branch]

    def _serve(self, branch: Branch) -> None:
        """Let a filter take the rows of the batch, and work out what they say."""
        if self._batch is not None:
            branch.take(self._batch)
            branch.refresh()

    def _catch_up(self) -> None:
        """Let every filter take all that there is."""
        while self._waiting:
            self._serve(self._waiting.pop())
        self._batch = self._recent.add(self._rows)
        for branch in self._all:
            self._serve(branch)
        self._branches = [branch for branch in self._branches if branch.healthy]

    def _split(self, t: float, running: Running) -> None:
        self._next_split = t + _EVERY
        names = [name for name in running.whole.names if name in running.free.names or name.startswith(GAIN_PREFIX)]
        wide = running.whole.only(names)
        steps = steps_of(self.vehicle, running, wide)
        last, calm = self._wide, self.suspect is None  # what a change makes known does not undo that it is suspected
        if last is None or (calm and (last.names != wide.names or np.any((steps > 0.0) != (self._steps > 0.0)))):
            self._branches.clear()  # hypotheses of one kind alone can be weighed against each other
            self._waters = None
            self._wide = last = wide
            self._steps = steps
            self._hypotheses = hypotheses(wide.free, steps)
        if not self._hypotheses:
            return
        self._count += 1
        lives = _LIVES_LONG if self._count % _OLD_ONE == 0 else _LIVES
        suspected = None if self.suspect is None else self.suspect[0]
        for branch in self._branches if self.suspect is None else ():
            done = branch.until <= t and branch.until - branch.t < _LIVES_LONG
            if done and branch.healthy and branch.increment is not None:
                self.overdispersion.learn(branch.increment, branch.steps)
        self._branches = [
            branch for branch in self._branches if branch.healthy and (branch.until > t or branch is suspected)
        ]
        self._branches.append(
            split_off(t, running.state, running.held, running.free, last.free, self._steps, t + lives)
        )

    def _judge(self, t: float, running: Running) -> Change | OtherWater | None:
        if not self.overdispersion.known:
            return None
        free = running.free
        verdict, branch = self._verdict(t)
        if verdict is None or branch is None:
            self.suspect = self._waters = None
            return None
        times, since = (1, t) if self.suspect is None else (self.suspect[1] + 1, self.suspect[2])
        self.suspect = branch, times, since
        thrusters = any(each.thruster is not None for each in self._hypotheses)
        if times < _AGAIN or (thrusters and t - since < _PERSISTS):
            return None
        self._catch_up()
        verdict, branch = self._verdict(t)
        if verdict is None or branch is None:
            return None
        finer = self._finely(branch, free, t)
        factor = self.overdispersion.factor
        verdict = judged([each.increment_now() for each in finer], self._hypotheses, factor)
        if verdict.clear < _CLEAR and t - since < _WAITS:
            return None
        branch = finer[verdict.best]
        if self._just_known(branch, running) and not t - self.requested < _TRUSTED:
            self.requested = t
            self.restart()
            return None
        lead, water = self._otherwise(t, branch, running, verdict.evidence)
        clearly = _CLEARLY * factor
        if 0.0 < lead < clearly and t - since < _WAITS:
            return None
        if lead >= clearly and water is not None:
            self.restart()
            return water
        return self._change(t, branch, verdict, running)

    def _just_known(self, branch: Branch, running: Running) -> bool:
        """Return whether a coefficient has become known, since a filter was split off, far from the linearisation.

        One that moves and is known no better moves because the vehicle is another.
        """
        at = [branch.free.names.index(name) for name in running.free.names]
        before = np.sqrt(np.maximum(np.diag(branch.P0)[at], 0.0))
        return bool(np.any(running.moved & (coefficient_std(running.state) < _KNOWN * before)))

    def _otherwise(self, t: float, best: Branch, running: Running, evidence: float) -> tuple[float, OtherWater | None]:
        """Return by how much water that moves otherwise is likelier than a change, and the filter in such water.

        Args:
            best: began where the change did. evidence: log Bayes factor of that, by its increment.
        """
        if not running.settings.current:
            return -np.inf, None
        gained = float(best.state.clock[0].log_likelihood) - float(running.state.clock[0].log_likelihood)
        of_change = max(gained, self.overdispersion.factor * evidence)
        whole = [each for each in self._branches if t - each.t <= _LIVES_LONG]  # of what followed others some is gone
        oldest = min(whole, key=lambda each: each.t, default=best)
        if self._waters is None:
            self._waters = Waters(running)
        begun = [each for each in (oldest, best) if t - each.t <= _LIVES_LONG and (each is best or each.t < best.t)]
        of_water, water = self._waters.weighed(begun, self._recent.since, running)
        found = None if water is None else OtherWater(water.t, t, of_water, water.running, water.kept)
        return of_water - of_change, found

    def _verdict(self, t: float) -> tuple[Verdict | None, Branch | None]:
        """Return what the filters say at t [s], and which fits best; None where nothing is sure."""
        overdispersion = self.overdispersion.factor
        sure = _SURE * math.sqrt(overdispersion)  # where increments err more, they err wildly more often
        counted = [
            (branch, branch.increment)
            for branch in self._branches
            if t - branch.t >= _YOUNGEST
            and branch.increment is not None
            and branch.healthy
            and branch.at_most > sure * overdispersion
        ]
        if not counted:
            return None, None
        verdict = judged([increment for _, increment in counted], self._hypotheses, overdispersion)
        return (verdict, counted[verdict.best][0]) if verdict.evidence > sure else (None, None)

    def _finely(self, best: Branch, free: FreeParameters, t: float) -> list[Branch]:
        """Return filters that were split off about when the best one was, in small steps of time."""
        out = [best]
        near = [branch for branch in self._branches if best.t - _EARLIER - 0.05 <= branch.t <= best.t + _LATER]
        for branch, later in zip(near, [*near[1:], None], strict=True):
            end = branch.t + _EVERY if later is None else later.t
            times = np.arange(branch.t + _FINELY, min(end, t - _AGED) - 0.5 * _FINELY, _FINELY)
            out += split_later(branch, free, self._recent.since(branch.t), [float(each) for each in times])
        return out

    def _change(self, t: float, branch: Branch, verdict: Verdict, running: Running) -> Change:
        whole = without_change_of(branch, verdict.steps)
        names = branch.free.names
        keep = [k for k, name in enumerate(names) if name in running.free.names or verdict.steps[k] > 0.0]
        prior = running.whole.only([names[k] for k in keep])
        state = with_coordinates(whole, prior.free, keep)
        places = {name: k for k, name in enumerate(running.free.names)}
        wider = np.array([running.disagreement[places[name]] if name in places else 1.0 for name in prior.names])
        apart = np.array([running.apart[places[name]] if name in places else 0.0 for name in prior.names])
        changed = running._replace(prior=prior, state=state, held=copied(branch.held), disagreement=wider, apart=apart)
        now = branch.P0 + np.diag(verdict.steps**2)
        one = (prior.free.codes[:, 0] == IN_GAIN) & (verdict.steps[keep] > 0.0)
        mean = np.where(one, state.theta, branch.theta0[keep])  # one fails: the scale of force stays (`seen_from`)
        kept = Kept(prior.names, mean, definite(now[np.ix_(keep, keep)]), state.linearised_at, wider, apart)
        before = branch.theta0[keep], np.sqrt(np.maximum(np.diag(branch.P0)[keep], 0.0))
        self.restart()
        self.likely = {}
        if self.known:
            known = [
                known_as(name, model, self.vehicle, branch.free, branch.theta0, branch.P0)
                for name, model in self.known.items()
            ]
            self._matching = ConfigurationMatch(
                branch, self._hypotheses, kept, verdict.steps, t + _COMPARED, known=known
            )
        return Change(branch.t, t, verdict, changed, kept, before)

    def _compare(self, t: float, matching: ConfigurationMatch, running: Running) -> Recognised | None:
        if not matching.branch.healthy or matching.branch.increment is None:
            return None
        factor, increment = self.overdispersion.factor, matching.branch.increment
        verdict = judged([increment], matching.hypotheses, factor)
        shares = likeness(increment.tempered(factor), matching.known, verdict.changed)
        self.likely = {one.name: float(share) for one, share in zip(matching.known, shares, strict=False)}
        best = int(np.argmax(shares[:-1]))
        name, share = matching.known[best].name, float(shares[best])
        if t > matching.until or running.free.names != matching.kept.names:
            self._matching = None
            return None
        if matching.taken is None and share > _TAKEN:
            matching.taken = name
            return self._take(t, matching, matching.known[best], share, running)
        if matching.taken is not None and self.likely[matching.taken] < _DROPPED:
            gone, matching.taken = matching.taken, None
            return self._give_up(t, matching, gone, running)
        return None

    def _take(self, t: float, matching: ConfigurationMatch, known: Known, share: float, running: Running) -> Recognised:
        """Inform the filter, and the prior of what follows, of what is known of the configuration."""
        kept = matching.kept
        at = [matching.branch.free.names.index(name) for name in kept.names]
        taken = copied(running.state)
        theta, covariance = known.theta[at], definite(known.covariance[np.ix_(at, at)])
        inform(taken, np.eye(len(at)), covariance, theta - taken.theta)
        mean, left = fused(kept.mean, kept.covariance, theta, covariance)
        self.restart(matching=True)
        informed = kept._replace(mean=mean, covariance=definite(left))
        return Recognised(t, known.name, share, True, running._replace(state=taken), informed)

    def _give_up(self, t: float, matching: ConfigurationMatch, name: str, running: Running) -> Recognised:
        """Go on from what the samples alone say."""
        self._catch_up()
        whole = without_change_of(matching.branch, matching.steps)
        at = [matching.branch.free.names.index(each) for each in matching.kept.names]
        state = with_coordinates(whole, running.free, at)
        alone = running._replace(state=state, held=copied(matching.branch.held))
        self.restart(matching=True)
        return Recognised(t, name, self.likely[name], False, alone, matching.kept)


class ChangeTracker:
    """A detector on a stream, once its inputs are known, and the log of what it detected.

    Args:
        vehicle: what is known of it. known: configurations that it may become, by name; None: nothing is looked for.
    """

    def __init__(self, vehicle: Vehicle, known: Mapping[str, Vehicle] | None) -> None:
        self._vehicle, self._known = vehicle, known
        self.detector: ChangeDetector | None = None
        self.change_log = ChangeLog()
        self._overdispersion = Overdispersion()

    @property
    def watching(self) -> bool:
        """Whether changes are looked for."""
        return self._known is not None

    @property
    def requested(self) -> float:
        """When a re-estimation was requested [s], since what was seen may be no change."""
        return -np.inf if self.detector is None else self.detector.requested

    @property
    def suspects(self) -> bool:
        """Whether a change is suspected, for a few seconds at most: who goes over the samples now makes both one."""
        return self.detector is not None and self.detector.suspect is not None

    @property
    def events(self) -> tuple[Event, ...]:
        """What happened, in the order of noticing."""
        return self.change_log.events

    @property
    def likely(self) -> dict[str, float]:
        """Known configurations and how probable each is, since the last change."""
        return {} if self.detector is None else dict(self.detector.likely)

    @property
    def overdispersion(self) -> tuple[float, ...]:
        """What was learned of the overdispersion of increments."""
        return self._overdispersion.numbers

    def restore(self, events: Sequence[Event], overdispersion: Sequence[float]) -> None:
        """Go on with what `events` and `overdispersion` of another one were."""
        self.change_log.restore(tuple(events))
        self._overdispersion.restore(overdispersion)

    def restart(self) -> None:
        """Begin anew: the filter's motion is another one."""
        self.change_log.settle()
        if self.detector is not None:
            self.detector.restart()

    def gone_over(self, *, same: bool) -> None:
        """Begin anew with a filter that went over the samples once more; with `same` it has the same coordinates."""
        self.change_log.gone_over = True
        if self.detector is not None:
            self.detector.restart(matching=same)

    def recovered(self, t: float) -> None:
        """Begin anew, since the filter had to recover at t [s]."""
        self.restart()
        self.change_log.recovered(t)

    def take_input(self, t: float, force: Array) -> None:
        """Take the forces (m,) asked for from t [s] on."""
        if self.detector is not None:
            self.detector.take_input(t, force)

    def take_row(
        self,
        t: float,
        z: Array,
        seen: float,
        running: Running,
        like: Buffer,
    ) -> Change | Recognised | OtherWater | None:
        """Take the row z (18,) of time t [s], after the filter; return what goes on in its place, where one does.

        Args:
            seen: motion so far [s]. like: a buffer of such inputs.
        """
        if self._known is None:
            return None
        if self.detector is None:
            self.detector = ChangeDetector(self._vehicle, like.fresh(), self._known, self._overdispersion)
        self.detector.take_row(t, z)
        if seen < _LEAST_MOTION:
            return None
        self.change_log.revise(t, running)
        detected = self.detector.step(t, running)
        if detected is not None:
            self.change_log.add(detected)
        return detected
