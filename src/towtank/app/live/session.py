"""The live session of the command line: links, recording and learner made, run, and ended in order."""

from __future__ import annotations

import contextlib
import hashlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import typer

from towtank.app.files import read_configurations, read_prior, read_vehicle
from towtank.app.live.facts import LiveFit, judged
from towtank.app.live.judge import Driven, Judge, Moment
from towtank.app.live.readings import Readings
from towtank.app.live.report import live_document, live_line, show_end
from towtank.app.live.view import LiveView
from towtank.app.tables.fits import usable_document
from towtank.app.terminal.guard import FAULT, drop_output
from towtank.app.terminal.output import Output
from towtank.app.terminal.page_option import new_page, serving
from towtank.dashboard.prediction import warm_up as warm_prediction_up
from towtank.errors import InputError
from towtank.identification import Learner
from towtank.identification.posterior.thrusters import with_gains_of
from towtank.live.links.urls import open_source
from towtank.live.pipeline.clock import steady_time
from towtank.live.recording.checkpoint import Checkpoint, Earlier, earlier
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner, warm_up
from towtank.recording import load_mapping
from towtank.recording.event import Event
from towtank.recording.mcap.log import McapLog
from towtank.vehicle import Provenance, Vehicle, save_vehicle
from towtank.vehicle.names import RESTORING

if TYPE_CHECKING:
    from towtank.app.live.coaching import Coaching
    from towtank.app.live.driving import Driving
    from towtank.app.live.reports import LiveReports
    from towtank.dashboard.page import Page
    from towtank.live.driving.helm import Helm
    from towtank.live.links.mavlink.source import MavlinkSource
    from towtank.live.links.source import Source
    from towtank.planning import Plan

__all__ = ["LiveOptions", "run_live"]

_FLUSH = 0.1  # s at most for which a sample waits in this process
_LINES = 1.0  # s between two lines of JSON
_SHOWN = 0.25  # s between two pictures


@dataclass(frozen=True)
class LiveOptions:
    """What was asked for on the command line."""

    sources: tuple[str, ...]
    vehicle: str
    record: Path | None = None
    resume: bool = False
    method: str = "joint"
    seconds: float | None = None
    window: float = 0.1
    free: tuple[str, ...] | None = None
    prior: str | None = None
    changes: bool = True
    configurations: Path | None = None
    mapping: Path | None = None
    model_file: Path | None = None
    report: Path | None = None
    json_lines: bool = False
    page: str | None = None
    foxglove: str | None = None
    keep_all: bool = False
    plan: Path | None = None
    drive: bool = False
    drive_by: str = "manual"
    drive_limit: float = 1.0


def run_live(options: LiveOptions, output: Output) -> None:
    """Run a live session and print how it ended."""
    vehicle = read_vehicle(options.vehicle, output)
    prior = None if options.prior is None else read_prior(options.prior, output)
    if prior is not None:
        vehicle, said = with_gains_of(vehicle, prior)
        for text in said:
            output.warn(text)
    known = None if options.configurations is None else read_configurations(options.configurations, output)
    plan = _plan(options, vehicle, output)
    mapping = None if options.mapping is None else load_mapping(options.mapping)
    sources = [(text, open_source(text, vehicle, mapping)) for text in options.sources]

    helm, commanded = _helm(options, vehicle, plan, sources, output)

    background = not all(source.patient for _, source in sources)

    def fresh() -> Learner:
        return new_learner(
            vehicle,
            options.method,
            options.free,
            prior,
            background=background,
            changes=options.changes,
            known=known,
        )

    learner = fresh()
    checkpoint, before = _earlier(options, vehicle, prior=prior, background=background, known=known)
    if before is None and options.record is not None and options.record.exists():
        raise InputError(f"{options.record}: exists already; add --resume to go on with it, or choose another name")
    with output.progress("making ready") as progress, output.telling_compilation():
        warm_up(vehicle, fresh(), progress)
        predicting = options.json_lines or output.console.is_terminal
        if options.page is not None or options.foxglove is not None or predicting:
            warm_prediction_up(vehicle)
        if options.page is not None or options.report is not None:
            from towtank.app.live.reports import warm_up as warm_reports_up

            warm_reports_up(vehicle)
    epoch = round(steady_time(), 3) if before is None else before.now_epoch()
    if before is not None and epoch != before.epoch:
        output.warn(
            f"this computer's clock is {before.epoch - epoch:.0f} s behind the end of {options.record}: "
            "the recording's times go on from its end"
        )
    learner = learner if before is None or before.learner is None else before.learner
    log = _log(options, vehicle, epoch, going_on=before is not None)
    try:
        session = Session(
            sources,
            vehicle,
            learner,
            epoch=epoch,
            window=options.window,
            log=log,
            checkpoint=checkpoint,
            interval=0.25
            if output.console.is_terminal or options.json_lines or options.page or options.foxglove
            else 1.0,
            keep_all=options.keep_all,
        )
        reports = _reports(options, session)
        judge = _judge(session, vehicle, shown=predicting or options.page is not None)
        coaching = _coaching(options, session, vehicle, plan)
        guide: Coaching | Driving | None = coaching
        if coaching is not None and helm is not None and commanded is not None:
            guide = _driving(options, session, commanded, helm, coaching)
        view = None if guide is None or plan is None else guide.view
        readings = Readings(session, vehicle, lambda: judge.text, view) if predicting else None
        if before is not None:
            with output.progress("learning from what was recorded") as progress:
                attributes = {} if before.recording is None else before.recording.attributes
                rows, since, inputs = before.rows(progress), before.since, before.inputs
                session.learning.catch_up(rows, since=since, inputs=inputs, attributes=attributes)
            output.say(_gone_on(options, before, session))
        page = _page(options, session, judge, vehicle, reports, guide, output)
        viewers = _foxglove(options, session, vehicle, epoch, output)
        session.open()
    except BaseException:
        if log is not None:
            log.close()
            if before is None:
                log.path.unlink(missing_ok=True)
        raise
    output.say(f"listening to {', '.join(options.sources)}")
    leading = contextlib.nullcontext() if guide is None else guide
    with _ends() as stop, serving(page, output.say), viewers, judge, leading, _keys(options, guide, output):
        status = _run(session, stop, options, vehicle, readings, output)
    with contextlib.suppress(TimeoutError):
        judge.judge()  # of all that was learned from
    _end(session, status, options, vehicle, reports, readings, judge, output)


def _reports(options: LiveOptions, session: Session) -> LiveReports | None:
    """Return what makes reports of a session; None where none can be asked for."""
    if options.page is None and options.report is None:
        return None
    from towtank.app.live.reports import LiveReports

    return LiveReports(session, options)


def _plan(options: LiveOptions, vehicle: Vehicle, output: Output) -> Plan | None:
    """Return the plan that is to be driven; None without one. Raises InputError."""
    if options.plan is None:
        return None
    from towtank.planning import read_plan

    plan = read_plan(options.plan)
    if options.method != "joint":
        raise InputError(f"--plan: the method {options.method} states no posterior to plan from; use joint")
    if not vehicle.thrusters:
        raise InputError(f"--plan: {vehicle.name} has no thrusters; add [[thrusters]] to its file")
    if plan.vehicle != vehicle.name:
        output.warn(f"{options.plan}: planned for {plan.vehicle}, driven by {vehicle.name}: its promises differ")
    return plan


def _leads(options: LiveOptions, vehicle: Vehicle) -> bool:
    """Whether the pilot is told what to drive."""
    return options.plan is not None or (
        options.page is not None and options.method == "joint" and bool(vehicle.thrusters)
    )


def _coaching(options: LiveOptions, session: Session, vehicle: Vehicle, plan: Plan | None) -> Coaching | None:
    """Return what leads the pilot: through a plan, or on the page through what narrows most; else None."""
    if not _leads(options, vehicle):
        return None
    from towtank.app.live.coaching import Coaching

    return Coaching(session, vehicle, plan, waits=options.drive)


def _helm(
    options: LiveOptions,
    vehicle: Vehicle,
    plan: Plan | None,
    sources: Sequence[tuple[str, Source]],
    output: Output,
) -> tuple[Helm | None, MavlinkSource | None]:
    """Return what steers, ready to, and the link that commands go through; neither unless it is to drive."""
    if not options.drive:
        return None, None
    from towtank.app.live.driving import helm_of, link_of, space_of

    space, link = space_of(plan), link_of(sources)
    with output.progress("making the guard ready"), output.telling_compilation():
        return helm_of(vehicle, space, options.drive_limit), link


def _driving(options: LiveOptions, session: Session, link: MavlinkSource, helm: Helm, coaching: Coaching) -> Driving:
    from towtank.app.live.driving import Driving
    from towtank.live.driving.sticks import Way

    return Driving(session, link, helm, coaching, Way(options.drive_by))


def _keys(
    options: LiveOptions, guide: Coaching | Driving | None, output: Output
) -> contextlib.AbstractContextManager[object]:
    """Return the keys of the terminal by which a drive is steered; nothing where there is none, or no terminal."""
    from towtank.app.terminal.keys import Keys, can_read_keys

    if not options.drive or guide is None or options.json_lines or not can_read_keys():
        return contextlib.nullcontext()
    names = {"d": "drive-on", "x": "drive-off", "b": "begin", "h": "hold"}
    output.say("keys: d switch the drive on, x off, b begin the segment, h hold; keep the space bar down to drive")
    pressed = {letter: partial(guide.ask, what) for letter, what in names.items()}
    return Keys(pressed, (" ", partial(guide.ask, "drive-key")))


def _judge(session: Session, vehicle: Vehicle, *, shown: bool = True) -> Judge:
    """Return what judges a session while it runs."""
    learning, driven = session.learning, Driven()
    learning.followers += (driven,)

    def look() -> Moment:
        learner = learning.learner
        found = learning.errands.ask(lambda: (learner.model(), learner.estimate, learning.recent.copy()))
        return Moment(found[0], found[1], found[2].recording(), session.events.all)

    return Judge(vehicle, look, driven, session.events.add, shown=shown)


def _page(
    options: LiveOptions,
    session: Session,
    judge: Judge,
    vehicle: Vehicle,
    reports: LiveReports | None,
    guide: Coaching | Driving | None,
    output: Output,
) -> Page | None:
    """Return the live page of a session, bound to its address; None where none is asked for."""
    if options.page is None:
        return None
    from towtank.dashboard.feed import About
    from towtank.dashboard.live_feed import LiveFeed

    names = (*vehicle.hydrodynamics, *RESTORING)
    before = {name: value for name in names if (value := vehicle.coefficient(name))}
    about = About(title=", ".join(options.sources), vehicle=vehicle, method=options.method, reference=before)
    feed = LiveFeed(session, about, lambda: judge.text, guide)
    return new_page(feed, options.page, output.say, reports=None if reports is None else reports.now)


def _foxglove(
    options: LiveOptions, session: Session, vehicle: Vehicle, epoch: float, output: Output
) -> contextlib.AbstractContextManager[object]:
    """Return a server for Foxglove, listening already; nothing where none is asked for."""
    if options.foxglove is None:
        return contextlib.nullcontext()
    from towtank.dashboard.prediction import FreeRuns
    from towtank.live.foxglove import LAYOUT, FoxgloveServer

    server = FoxgloveServer(session, vehicle, epoch, options.foxglove, FreeRuns(vehicle))
    output.say(f"foxglove: ws://{server.open()}")
    output.say(f"foxglove: a layout to import there: {LAYOUT}")
    return contextlib.closing(server)


def _earlier(options: LiveOptions, vehicle: Vehicle, **settings: Any) -> tuple[Checkpoint | None, Earlier | None]:
    """Return the checkpoint beside the recording, and the session that is gone on with, where there are any."""
    if options.record is None:
        return None, None
    digest = hashlib.sha256(vehicle.model_dump_json(warnings=False).encode()).hexdigest()
    about: dict[str, Any] = {"method": options.method, "free": options.free, "prior": options.prior, "vehicle": digest}
    about["changes"] = options.changes
    checkpoint = Checkpoint(options.record, about)
    if not (options.resume and options.record.exists()):
        return checkpoint, None
    return checkpoint, earlier(options.record, vehicle, checkpoint, **settings)


def _log(options: LiveOptions, vehicle: Vehicle, epoch: float, *, going_on: bool) -> McapLog | None:
    if options.record is None:
        return None
    if going_on:
        return McapLog.resume(options.record, interval=_FLUSH)
    return McapLog.open(
        options.record,
        source=", ".join(options.sources),
        epoch=datetime.fromtimestamp(epoch, UTC),
        attributes={"vehicle": vehicle.name},
        interval=_FLUSH,
    )


def _gone_on(options: LiveOptions, before: Earlier, session: Session) -> str:
    if before.recording is None:
        return f"{options.record}: nothing was recorded yet; recording starts now"
    instants = session.learning.now.instants
    how = "once more" if before.learner is None else "after its checkpoint"
    recorded = f"{before.recording.duration:.5g} s recorded"
    return f"{options.record}: resumed, {recorded}, {instants} instants learned from {how}"


def _run(
    session: Session,
    stop: threading.Event,
    options: LiveOptions,
    vehicle: Vehicle,
    readings: Readings | None,
    output: Output,
) -> Status:
    if options.json_lines and readings is not None:
        shown = Audience(JsonLines(readings).show, session)
        return session.run(stop, seconds=options.seconds, show=shown, period=_SHOWN)
    view = LiveView(output, vehicle, options.method, readings)
    with view.showing() as show:
        audience = None if show is None else Audience(show, session)
        return session.run(stop, seconds=options.seconds, show=audience, period=_SHOWN)


class Audience:
    """Shows a session while somebody looks: a terminal or a reader that is gone ends neither recording nor learning."""

    def __init__(self, show: Callable[[Status], None], session: Session) -> None:
        self._show, self._session = show, session
        self._gone = False

    def __call__(self, status: Status) -> None:
        """Show how things stand, as long as that can be written."""
        if self._gone:
            return
        try:
            self._show(status)
        except OSError as error:
            self._gone = True
            drop_output()
            text = f"nobody reads the output any more ({error.strerror or error}); the session goes on"
            self._session.events.add(Event(max(status.learnt.t, 0.0), "output", text))


class JsonLines:
    """Writes a line a second; at once where data stop coming or to count, or the recording is in trouble, and after."""

    def __init__(self, readings: Readings) -> None:
        self._readings = readings
        self._written: tuple[Event, ...] = ()
        self._state, self._due = (False, "", False), 0.0

    def show(self, status: Status) -> None:
        """Write a line where one is due."""
        cut, now = status.learnt.left_out, time.monotonic()
        state = status.silent is not None, "" if cut is None else cut.kind, status.in_trouble
        if now < self._due and state == self._state:
            return
        self._state, self._due = state, now + _LINES
        new = [event for event in status.events if event not in self._written]
        self._written = status.events
        _write(live_line(status, self._readings.read(status), new))


def _end(
    session: Session,
    status: Status,
    options: LiveOptions,
    vehicle: Vehicle,
    reports: LiveReports | None,
    readings: Readings | None,
    judge: Judge,
    output: Output,
) -> None:
    """Write the model and the report, print what was learned; end with a fault where something could not be kept."""
    learner = session.learning.learner
    failed = _not_kept(session, status)
    place = _model_place(options, status)
    if place is not None:
        kept = learner.model()
        note = f"learned live from {', '.join(options.sources)} ({status.learnt.estimate.duration:.5g} s)"
        provenance = Provenance(source=kept.provenance.source, notes=(*kept.provenance.notes, note))
        model = kept.model_copy(update={"provenance": provenance})
        place = _written(place, partial(save_vehicle, model, place), failed)
    report = options.report
    if reports is not None and report is not None:
        report = _written(report, partial(reports.write, report, output.warnings, judge.use), failed)
    fit = judged(
        session.learning, None if status.recording is None else status.recording.path, keep_all=options.keep_all
    )
    use = {"verdict": judge.text, "usable": usable_document(judge.use)}
    warnings = [*output.warnings, *failed]
    document = use | live_document(status, learner, options.sources, options.prior, options.method, warnings, fit)
    try:
        if options.json_lines and readings is not None:
            _write(live_line(status, readings.read(status)) | {"final": True, **document})
        else:
            output.line()
            output.line(judge.text, "bold")
            _show_end(status, vehicle, options, fit, place, report, output)
            output.document(document)
            sys.stdout.flush()
    except OSError as error:
        drop_output()
        failed.append(f"the output could not be written ({error.strerror or error})")
    if any(event.kind == "output" for event in status.events):
        failed.append("nobody read the output to its end")
    if failed:
        with contextlib.suppress(OSError):
            sys.stderr.write(f"towtank: {'; '.join(failed)}\n")
        raise typer.Exit(FAULT)


def _show_end(
    status: Status,
    vehicle: Vehicle,
    options: LiveOptions,
    fit: LiveFit,
    place: Path | None,
    report: Path | None,
    output: Output,
) -> None:
    """Print what was learned, and which files there are."""
    show_end(status, vehicle, options.method, fit, output)
    if place is not None:
        output.line(f"model written to {place}")
    elif options.model_file is None:
        output.line("the model is not saved; -o MODEL.toml or --record saves it", "dim")
    if report is not None:
        output.line(f"report written to {report}")
    if status.recording is not None:
        output.line(f"Next: towtank learn {status.recording.path} --vehicle {options.vehicle} -o MODEL.toml", "dim")


def _not_kept(session: Session, status: Status) -> list[str]:
    """Return what of a session was not kept: losses of the recording, learning that has stopped."""
    failed, recording = [], status.recording
    if recording is not None and recording.lost:
        failed.append(f"{recording.path}: {recording.lost} samples and packets were not recorded")
    if recording is not None and not recording.complete:
        why = f" ({recording.trouble})" if recording.trouble else ""
        failed.append(f"{recording.path}: could not be closed{why}; what is in it can be read")
    return [*failed, status.learnt.trouble] if status.learnt.trouble else failed


def _written(place: Path, write: Callable[[], object], failed: list[str]) -> Path | None:
    """Return where something was written; None where that failed, which is added to `failed`."""
    try:
        write()
    except InputError as error:
        failed.append(str(error))
    except OSError as error:
        failed.append(f"{place}: cannot be written ({error.strerror or error})")
    else:
        return place
    return None


def _model_place(options: LiveOptions, status: Status) -> Path | None:
    """Return where the model goes: as asked, else beside the recording under a name that is free."""
    if options.model_file is not None or options.record is None or not any(status.learnt.estimate.identified):
        return options.model_file
    place = options.record.with_suffix(".toml")
    number = 2
    while place.exists():
        place = options.record.with_name(f"{options.record.stem}-{number}.toml")
        number += 1
    return place


def _write(line: dict[str, object]) -> None:
    import json

    from towtank.app.terminal.output import plain

    sys.stdout.write(json.dumps(plain(line), allow_nan=False) + "\n")
    sys.stdout.flush()


@contextlib.contextmanager
def _ends() -> Iterator[threading.Event]:
    """Yield what Ctrl-C, SIGTERM and SIGHUP set; a second Ctrl-C or SIGTERM ends at once.

    A terminal that closes sends SIGHUP more than once: from the first on it is ignored, so that the end is in order. It
    is ignored all along where it was before, as `nohup` has it.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    wanted = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        wanted.append(signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in wanted}

    def asked(number: int, frame: FrameType | None) -> None:
        stop.set()
        if number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, before[signal.Signals(number)])
        else:
            before[signal.Signals(number)] = signal.SIG_IGN

    for number in before:
        signal.signal(number, asked)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
