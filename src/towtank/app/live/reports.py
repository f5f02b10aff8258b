"""The report of a live session, at its end and for the page at any time, with estimates over time in little memory."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from towtank.app.commands.arguments import command_text
from towtank.app.files import read_logs
from towtank.app.live.facts import Knowledge, knowledge_of, stream_facts
from towtank.app.reports import origin_of, write_report
from towtank.core.arrays import Array
from towtank.identification import Estimate, Learner
from towtank.identification.offline.convergence import Convergence
from towtank.live.session import Session
from towtank.recording import Recording
from towtank.report.learn_page import report_html
from towtank.simulation import simulate
from towtank.validation import Usability, validate
from towtank.vehicle import Vehicle

if TYPE_CHECKING:
    from towtank.app.live.session import LiveOptions

__all__ = ["LearnedCurve", "LiveReports", "warm_up"]

_STEP, _MOST = 0.5, 800  # s between two readings at first; readings


class LearnedCurve:
    """Reads a learner from time to time; called, by its own thread, with time [s] and arguments of every instant."""

    def __init__(self, learner: Learner) -> None:
        self._learner, self._step = learner, _STEP
        self._rows: list[tuple[float, dict[str, tuple[float, float]]]] = []

    def __call__(self, t: float, arguments: Mapping[str, Any]) -> None:
        """Take note of the estimate where that is due."""
        if self._rows and 0.0 <= t - self._rows[-1][0] < self._step:
            return
        if len(self._rows) == _MOST:
            self._rows, self._step = self._rows[::2], 2.0 * self._step
        known = {each.name: (each.value, each.std) for each in self._learner.estimate.coefficients if each.identified}
        self._rows.append((t, known))

    def convergence(self, estimate: Estimate) -> Convergence:
        """Return how what is identified by now came about."""
        names = tuple(each.name for each in estimate.coefficients if each.identified)
        rows, nothing = self._rows.copy(), (np.nan, np.nan)
        pairs: Array = np.array([[known.get(name, nothing) for name in names] for _, known in rows])
        pairs = pairs.reshape(len(rows), len(names), 2)
        return Convergence(names, np.array([t for t, _ in rows]), pairs[:, :, 0], pairs[:, :, 1])


class LiveReports:
    """Makes reports of one session; to be made before that runs."""

    def __init__(self, session: Session, options: LiveOptions) -> None:
        self._session, self._options = session, options
        self._curve = LearnedCurve(session.learning.learner)
        session.learning.listeners += (self._curve,)
        self._one_at_a_time = threading.Lock()

    def now(self) -> bytes:
        """Return the report as of now, of the last minute, for another thread than the one that learns.

        Raises:
            TimeoutError: the learner is too busy to be asked.
        """
        learning = self._session.learning
        with self._one_at_a_time:
            now, convergence, recent = learning.errands.ask(lambda: (*self._knowledge(), learning.recent.copy()))
            return self._html(now, convergence, recent.recording()).encode()

    def write(self, path: Path, warnings: Sequence[str], use: Usability | None = None) -> None:
        """Write the report of a session that has ended: of its recording, where there is one, else of the last minute.

        Args:
            use: for how long the model predicts, as the session ended.

        Raises:
            InputError: it cannot be written.
        """
        kept = self._options.record
        recording = self._session.learning.recent.recording()
        if kept is not None and recording is not None:
            (recording,) = read_logs([kept], None, lambda text, share: None)
        write_report(path, self._html(*self._knowledge(), recording, kept=kept, warnings=warnings, use=use))

    def _knowledge(self) -> tuple[Knowledge, Convergence]:
        now = knowledge_of(self._session.learning.learner)
        return now, self._curve.convergence(now.estimate)

    def _html(
        self,
        now: Knowledge,
        convergence: Convergence,
        recording: Recording | None,
        *,
        kept: Path | None = None,
        warnings: Sequence[str] = (),
        use: Usability | None = None,
    ) -> str:
        status, options = self._session.status(), self._options
        span = 0.0 if recording is None else recording.duration
        facts = stream_facts(
            now,
            recording,
            of="the recording" if kept is not None else f"the last {span:.0f} s",
            events=status.events,
            convergence=convergence,
            epoch=status.epoch,
            prior=options.prior,
            warnings=[*warnings, *status.warnings],
            keep_all=options.keep_all,
            use=use,
        )
        return report_html(facts.of(origin_of([] if kept is None else [kept], _commands(options))))


def warm_up(vehicle: Vehicle) -> None:
    """Compile what a report computes with, on a second of a vehicle at rest."""
    count = len(vehicle.thrusters)
    commands, wrench = (np.zeros((100, count)), None) if count else (None, np.zeros((100, 6)))
    validate(vehicle, [simulate(vehicle, commands=commands, wrench=wrench, dt=0.01)])


def _commands(options: LiveOptions) -> list[str]:
    """Return what makes it again, and what comes next."""
    asked = {
        "--vehicle": options.vehicle,
        "--record": options.record,
        "--method": None if options.method == "joint" else options.method,
        "--free": None if options.free is None else ",".join(options.free),
        "--prior": options.prior,
        "--no-changes": not options.changes,
        "--keep-all": options.keep_all,
        "--configurations": options.configurations,
        "--map": options.mapping,
        "-o": options.model_file,
    }
    commands = [command_text("live", options.sources, asked)]
    if options.record is not None:
        commands.append(command_text("learn", [options.record], {"--vehicle": options.vehicle, "-o": "MODEL.toml"}))
    return commands
