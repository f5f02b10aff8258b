"""The joint filter on a stream: it takes row after row, and goes over what was seen once more at times that grow.

Between two re-estimations the filter stays linear about what the last one found; a coefficient that becomes known far
from there, or a sensor that is heard for the first time, calls for the next one. Rows of sensors that are late are put
back to the times that they speak of, so that the filter is as far behind as the latest of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import hold_force, restored_hold
from towtank.identification.changes.branch import Kept, Running
from towtank.identification.changes.detector import ChangeTracker
from towtank.identification.changes.events import Change, OtherWater
from towtank.identification.data.samples import N_MEASURED, Buffer, NoiseLevels
from towtank.identification.kalman.filter import take_row
from towtank.identification.kalman.passes import since_last
from towtank.identification.kalman.problem import latencies_of
from towtank.identification.kalman.state import (
    FilterSettings,
    HealthySnapshot,
    forget_surroundings,
    healthy_snapshot,
    recovered,
    restored_state,
)
from towtank.identification.model.parameters import FURTHER
from towtank.identification.online.reestimation import (
    Beside,
    Found,
    Question,
    Reestimation,
    Schedule,
    begun_anew,
    caught_up,
    is_full,
)
from towtank.recording.event import Event
from towtank.vehicle import Vehicle, configuration_matrix

__all__ = ["JointStream"]

_CHECKED = 0.5  # s from one check of the filter to the next
_MOST_EARLY = 500  # rows kept before the first input
_TO_CHANGE, _TO_WATER = 2.0, 20.0  # s of motion after which a change, and other water, are looked at again
_TOGETHER = 1e-6  # s: rows closer than this are one


class RowsInOrder:
    """Rows at the times that they speak of: those of late sensors are put back, the others wait for them.

    Args:
        latency: of each sensor (6,) [s].
    """

    def __init__(self, latency: Array) -> None:
        self._latency = latency
        self._longest = max(0.0, float(latency.max()))
        self.waiting: list[tuple[float, Array]] = []

    def take(self, t: float, z: Array) -> list[tuple[float, Array]]:
        """Take the row z (18,) that came at t [s]; return those before which nothing can come any more."""
        if not self._latency.any():
            return [(t, z)]
        numbers = z.reshape(-1, 3)
        for late in np.unique(self._latency[np.isfinite(numbers).any(axis=1)]):
            part = np.where((self._latency == late)[:, None], numbers, np.nan).ravel()
            self._put(t - float(late), part)
        ready = [k for k, (at, _) in enumerate(self.waiting) if at <= t - self._longest + _TOGETHER]
        out = self.waiting[: len(ready)]
        self.waiting = self.waiting[len(ready) :]
        return out

    def _put(self, t: float, part: Array) -> None:
        k = len(self.waiting)
        while k and self.waiting[k - 1][0] > t + _TOGETHER:
            k -= 1
        if k and self.waiting[k - 1][0] > t - _TOGETHER:
            at, there = self.waiting[k - 1]
            self.waiting[k - 1] = at, np.where(np.isfinite(part), part, there)
        else:
            self.waiting.insert(k, (t, part))


class JointStream:
    """The filter with what it needs to re-estimate.

    Args:
        question: what is to be learned.
        background: re-estimations run beside the stream, in a thread; the stream does not wait for them.
        known: configurations that the vehicle may become, by name; None: changes are not watched for.

    Attributes:
        running: the filter, None before the first re-estimation. kept: what was learned from rows that are gone.
        seen: time with inputs and rows [s]. recoveries: how often the filter had to recover.
    """

    def __init__(
        self, question: Question, *, background: bool = False, known: Mapping[str, Vehicle] | None = None
    ) -> None:
        self.question = question
        self.seen = 0.0
        self.running: Running | None = None
        self.kept: Kept | None = None
        self.recoveries = 0
        self.schedule = Schedule()
        self.changes = ChangeTracker(question.vehicle, known)
        self._beside = Beside() if background else None
        self._buffer: Buffer | None = None  # from the first input on
        self._early: list[tuple[float, Array]] = []
        self._order = RowsInOrder(np.zeros(N_MEASURED // 3))
        self._heard = np.zeros(N_MEASURED, dtype=bool)  # columns that the last re-estimation knew of
        self._next_check, self._last_t = 0.0, -np.inf
        self._broken_off = False  # and nothing has come since
        self._healthy: HealthySnapshot | None = None

    # -- data in

    def take_input(self, t: float, force: Array, *, commands: bool) -> None:
        """Take the forces (m,) that the thrusters are asked for from t [s] on."""
        if not (np.isfinite(t) and np.isfinite(force).all()):
            return
        if self._buffer is None:
            vehicle = self.question.vehicle
            shape = configuration_matrix(vehicle) if commands else np.eye(6)
            lag = np.array([thruster.time_constant for thruster in vehicle.thrusters]) if commands else np.zeros(6)
            self._buffer = Buffer(shape, lag, commands=commands)
            for row in self._early:
                self._buffer.add_row(*row)
            self._early.clear()
        self._buffer.add_input(t, force)
        if self.running is not None:
            hold_force(self.running.held, t, force)
            self.changes.take_input(t, force)

    def take_row(self, t: float, z: Array) -> bool:
        """Take the measurements z (18,) of time t [s]; return whether anything was learned from them."""
        if not (np.isfinite(t) and t > self._last_t):
            return False
        last, self._last_t = self._last_t, t
        if self._broken_off and self.running is not None:  # in the water of the last stretch, if that is not long ago
            forget_surroundings(self.running.state, since_last(self.running.state, np.array([t])))
        self._broken_off = False
        buffer = self._buffer
        if buffer is None:
            self._early = [*self._early[-_MOST_EARLY:], (t, z)]
            return False
        if np.isfinite(last):
            self.seen += min(t - last, 1.0)
        buffer.add_row(t, z)
        learned = False
        if self.running is not None:
            for at, row in self._order.take(t, z):
                learned = take_row(self.running.state, self.running.held, at, row) or learned
                if self.changes.watching:
                    self._detect_change(buffer, self.running, at, row)
            if self.seen >= self._next_check:
                self._next_check = self.seen + _CHECKED
                self._check(buffer, self.running)
        self._reestimate(self._buffer or buffer)
        return learned

    def break_off(self) -> None:
        """Begin a new stretch: motion is not drawn across to it."""
        self._last_t = -np.inf
        if self._buffer is not None:
            self._buffer.break_off()
            if self.running is not None:
                self._go_on(begun_anew(self.running, self._buffer.fresh().whole, self._delay, 0.0))
                self._broken_off = True
        self.changes.restart()

    @property
    def begun(self) -> bool:
        """Whether any row has been taken."""
        return bool(self._early) or self._buffer is not None

    @property
    def commanded(self) -> bool | None:
        """Whether the inputs are commands of thrusters; None before the first."""
        return None if self._buffer is None else self._buffer.commands

    @property
    def rows(self) -> int:
        """Rows that something was learned from."""
        return 0 if self.running is None else int(self.running.state.clock[0].rows)

    # -- to a file and back

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return what it knows: plain data, and arrays by name.

        A re-estimation that runs beside is not waited for: the stream that is made of them begins it anew.
        """
        running, buffer, kept = self.running, self._buffer, self.kept
        busy = self._beside is not None and self._beside.busy
        plain: dict[str, Any] = {
            "running": None if running is None else _plain(running),
            "kept": None if kept is None else kept.names,
            "seen": self.seen,
            "recoveries": self.recoveries,
            "watching": self.changes.watching,
            "overdispersion": self.changes.overdispersion,
            "events": [[each.t, each.kind, each.text, dict(each.details)] for each in self.changes.events],
            "next_check": self._next_check,
            "last_t": self._last_t if np.isfinite(self._last_t) else None,
            "schedule": asdict(self.schedule) | ({"next": self.seen} if busy else {}),
            "buffer": None if buffer is None else {"commands": buffer.commands, "starts": buffer.starts},
        }
        groups: dict[str, dict[str, Any]] = {"stream": {"heard": self._heard}}
        early = self._early if buffer is None else self._order.waiting
        groups["waiting"] = {
            "t": np.array([t for t, _ in early]),
            "values": np.array([z for _, z in early]).reshape(-1, N_MEASURED),
        }
        if kept is not None:
            groups["kept"] = {name: value for name, value in kept._asdict().items() if name != "names"}
        if buffer is not None:
            whole = buffer.whole
            rows = {"t": whole.t, "values": whole.values, "input_t": whole.input_t, "input_force": whole.input_force}
            groups["buffer"] = {"B": buffer.B, "lag": buffer.lag, **rows}
        if running is not None:
            groups |= {"state": running.state._asdict(), "held": running.held._asdict()}
            levels = {each.name: np.asarray(getattr(running.levels, each.name)) for each in fields(running.levels)}
            groups |= {"levels": levels}
            groups["running"] = {"disagreement": running.disagreement, "apart": running.apart}
        return plain, {f"{group}.{name}": value for group, each in groups.items() for name, value in each.items()}

    def restore(self, plain: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
        """Go on with what `to_arrays` of another stream of the same vehicle and settings gave."""

        def group(name: str) -> dict[str, Any]:
            return {key.removeprefix(f"{name}."): array for key, array in arrays.items() if key.startswith(f"{name}.")}

        events = [Event(t, kind, text, details) for t, kind, text, details in plain["events"]]
        self.changes.restore(events, plain["overdispersion"])
        self.schedule = Schedule(**plain["schedule"])
        self.seen, self.recoveries = float(plain["seen"]), int(plain["recoveries"])
        self._next_check = float(plain["next_check"])
        self._last_t = -np.inf if plain["last_t"] is None else float(plain["last_t"])
        self._heard = np.array(arrays["stream.heard"])
        if plain["kept"] is not None:
            self.kept = Kept(tuple(plain["kept"]), **group("kept"))
        waiting = [(float(t), z) for t, z in zip(*group("waiting").values(), strict=True)]
        if plain["buffer"] is None:
            self._early = waiting
            return
        rows = group("buffer")
        self._buffer = Buffer(rows.pop("B"), rows.pop("lag"), commands=bool(plain["buffer"]["commands"]))
        self._buffer.restore(**rows, starts=plain["buffer"]["starts"])
        if plain["running"] is not None:
            about = plain["running"]
            sensors = [name for name in about["names"] if name in FURTHER]
            whole = self.question.whole(self.kept, commands=self._buffer.commands, more=sensors)
            levels = group("levels")
            running = Running(
                whole,
                whole.only(about["names"]),
                restored_state(arrays, "state."),
                restored_hold(arrays, "held."),
                arrays["running.disagreement"],
                arrays["running.apart"],
                FilterSettings(**about["settings"] | {"usual": tuple(about["settings"]["usual"])}),
                NoiseLevels(**levels | {name: float(levels[name]) for name in ("current_walk", "heading_bias")}),
                tuple(about["remarks"]),
            )
            self._go_on(running)
            self._order.waiting = waiting

    # -- inside

    @property
    def _delay(self) -> float:
        return self.question.delay or 0.0

    def _go_on(self, running: Running) -> None:
        """Go on with another filter."""
        self.running = running
        self._order = RowsInOrder(latencies_of(running.free, running.state.linearised_at))
        self._healthy = healthy_snapshot(running.state) or self._healthy

    def settle(self) -> None:
        """Wait for a re-estimation that runs beside; do one more where the stream has left them behind."""
        if self._beside is None or self._buffer is None:
            return
        if self._beside.busy:
            self._adopt(self._buffer, self._beside.fetch())
        if self.schedule.behind(self.seen):
            self.schedule.done(self.seen)
            self._adopt(self._buffer, self._job(self._buffer).run())

    def _reestimate(self, buffer: Buffer) -> None:
        """Adopt a re-estimation that is done, and begin the next one when it is due."""
        beside = self._beside
        if beside is not None and beside.busy:
            if beside.done and not self.changes.suspects:
                self._adopt(buffer, beside.fetch())
            return
        if (self.seen < self.schedule.next or self.changes.suspects) and not is_full(buffer):
            return
        self.schedule.done(self.seen)
        if beside is not None:
            beside.begin(self._job(buffer))
        else:
            self._adopt(buffer, self._job(buffer).run())

    def _job(self, buffer: Buffer) -> Reestimation:
        in_waves = self.kept is not None and self.running is not None and bool(self.running.levels.waves.any())
        anew = self.schedule.from_prior(self.seen) and not in_waves  # what follows a change is too short to show them
        return Reestimation.of(self.question, buffer, self.kept, None if anew else self.running)

    def _adopt(self, buffer: Buffer, found: Found | None) -> None:
        """Go on with what was found, after what came while the job ran beside."""
        if found is None:
            if is_full(buffer):
                self._buffer = buffer.without(buffer.rows // 2)
            return
        same = self.running is not None and self.running.free.names == found.running.free.names
        self.changes.gone_over(same=same)
        self.schedule.settle()
        since, until = (found.rows, found.inputs), (buffer.rows, buffer.inputs)
        running = caught_up(found.running, buffer, since, until, self._delay)
        self.kept = found.kept
        self._heard = buffer.measured
        if found.gone:
            self._buffer = buffer.without(found.gone)
        self._go_on(running)

    def _check(self, buffer: Buffer, running: Running) -> None:
        """Let a filter that has lost itself recover; re-estimate soon where there is reason to."""
        snapshot = healthy_snapshot(running.state)
        if snapshot is None:
            if self._healthy is not None:
                self._recover(buffer, running, self._healthy)
            return
        self._healthy = snapshot
        if running.moved.any() or np.any(buffer.measured & ~self._heard):
            self.schedule.call(self.seen)

    def _recover(self, buffer: Buffer, running: Running, healthy: HealthySnapshot) -> None:
        self.recoveries += 1
        state = recovered(running.state, healthy, running.free, running.settings)
        anew = begun_anew(running._replace(state=state), buffer.fresh().whole, self._delay)
        anew.state.current_at[:] = running.state.current_at
        self._go_on(anew)
        self.changes.recovered(self._last_t)

    def _detect_change(self, buffer: Buffer, running: Running, t: float, z: Array) -> None:
        """Go on with the filter that saw a change, where one did, and with what was known before as its prior."""
        if not self.schedule.settled:  # what contradicts a supposition of how the water moves is no change
            return
        found = self.changes.take_row(t, z, self.seen, running, buffer)
        if found is None:
            if self.changes.requested == t:
                self.schedule.call(self.seen)
            return
        if self._beside is not None:
            self._beside.forget()
        if isinstance(found, Change | OtherWater):
            first = buffer.starts[-1][0]
            self._buffer = buffer.without(first + int(np.searchsorted(buffer.whole.t[first:], found.t, side="right")))
        self.kept = found.kept
        self.schedule.anew(self.seen, _TO_WATER if isinstance(found, OtherWater) else _TO_CHANGE)
        waiting = self._order.waiting
        self._go_on(found.running)
        self._order.waiting = waiting


def _plain(running: Running) -> dict[str, Any]:
    return {"names": running.prior.names, "settings": asdict(running.settings), "remarks": running.remarks}
