"""`towtank demo`: a simulated tank session, learned sample by sample, judged on a session never seen.

It is what live data will do: `Learner.update` with every pose and its commands, an estimate to be read at any time,
and at the end a vehicle file. Everything is compiled before its clock starts, with a word to whoever waits.
"""

from __future__ import annotations

import sys
import threading
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from towtank.app.demo.files import write_demo
from towtank.app.demo.progress import LearningCurve, quantities
from towtank.app.demo.stream import Moment, stream
from towtank.app.demo.table import Screen, coefficient_table
from towtank.app.demo.warm_up import warm_up
from towtank.app.demo.words import commands, fit_text, plan, verdict
from towtank.app.live.facts import knowledge_of, stream_facts
from towtank.app.live.report import events_document
from towtank.app.reports import learn_facts
from towtank.app.terminal.output import COMPILING, Output, watching_compilation
from towtank.app.terminal.page_option import new_page, page_address, serving
from towtank.errors import InputError
from towtank.identification import Learner, learn_recordings
from towtank.outputs import write_text
from towtank.report import LearnFacts
from towtank.simulation.tank import DELAY, DURATION, SEED, Session, tank_session, unseen_session
from towtank.validation import Validation, validate

if TYPE_CHECKING:
    from towtank.app.demo.feed import DemoFeed
    from towtank.dashboard.page import Page

__all__ = ["run_demo"]

_SHORTEST, _LONGEST = 2.0, 3600.0  # s
_TITLE = "towtank demo: a small ROV in a simulated tank, learned while it moves"


def run_demo(
    output: Path,
    *,
    seconds: float | None = None,
    fast: bool = False,
    browser: bool = False,
    page: str | None = None,
    payload: bool = False,
    console: Console,
    json_output: bool = False,
) -> dict[str, Any]:
    """Run the demo and return its JSON document.

    Args:
        output: folder for model, recordings, figures and page; made where it does not exist.
        seconds: length of the session, default 180. fast: do not wait for the clock.
        browser: open the page at the end, where standard output is a terminal.
        page: HOST:PORT of the live page, opened at the start instead; None: there is none.
        payload: the vehicle takes one up, after the axes in turn.
        console: takes table, progress and messages. json_output: standard output belongs to the document alone.

    Raises:
        InputError: the folder or the page cannot be made, or the length is out of range.
    """
    duration = DURATION if seconds is None else float(seconds)
    if not _SHORTEST <= duration <= _LONGEST:
        raise InputError(f"--seconds: found {duration:g}, expected {_SHORTEST:g} to {_LONGEST:g}")
    page_address(page)
    _make_folder(output)
    _say(console, _TITLE, "bold")
    with watching_compilation(lambda: _say(console, COMPILING, "yellow")):
        warm_up()
    session = tank_session(duration, payload=payload)
    _say(console, plan(session, fast))
    console.print()

    learner = Learner(session.known, background=not fast)
    curve = LearningCurve(quantities(session.truth, weight=payload))
    watched = not json_output and sys.stdout.isatty()
    feed, live = _page(session, learner, curve, page, console)
    judging = nullcontext() if feed is None else feed.judge
    with serving(live, lambda line: _whole(console, line), browser=browser and watched), judging:
        screen = Screen(console, session)
        with screen.showing() as show:
            last = stream(session, learner, curve, paced=not fast, show=show, watch=feed)

        if feed is not None:
            feed.streamed()
        facts = _as_it_is(session, learner) if payload else _second_pass(console, session, curve)
        if feed is not None:
            again = "" if payload else "learned once more from the whole recording"
            feed.finish(facts.estimate, facts.model, facts.delay, again)
        unseen = unseen_session(payload=payload)
        judged = validate(facts.model, [unseen.recording])
        files = write_demo(output, session, unseen, facts, judged, curve)
        if feed is not None:
            feed.written(files[0].read_bytes())
        console.print()
        console.print(coefficient_table(curve, ascii_only=screen.ascii_only, final=True))
        console.print()
        _say(console, verdict(curve), "bold")
        _say(console, fit_text(judged))
        console.print()
        _say(console, f"written to {output}: {', '.join(path.name for path in files)}")
        _say(console, "next, with a log of your own vehicle:")
        _whole(console, f"  {commands(output)[0][1]}")
        if live is not None and watched:
            _stay(console)
        elif browser and watched:
            import webbrowser

            webbrowser.open(files[0].resolve().as_uri())
        return _document(session, facts, curve, judged, files, last)


def _page(
    session: Session, learner: Learner, curve: LearningCurve, place: str | None, console: Console
) -> tuple[DemoFeed | None, Page | None]:
    """Return what the live page shows, and the page; nothing where none is asked for."""
    if place is None:
        return None, None
    from towtank.app.demo.feed import DemoFeed

    feed = DemoFeed(session, learner, curve)
    return feed, new_page(feed, place, lambda line: _say(console, line), reports=feed.report)


def _stay(console: Console) -> None:
    """Keep the page until Ctrl-C."""
    _say(console, "the page stays until Ctrl-C")
    with suppress(KeyboardInterrupt):
        threading.Event().wait()


def _as_it_is(session: Session, learner: Learner) -> LearnFacts:
    """Return what the learner knows of a vehicle that has changed: a log is learned from as if it never did."""
    learner.settle()
    facts = stream_facts(knowledge_of(learner), None, of="", events=learner.events)
    return replace(facts, recordings=[session.recording])


def _second_pass(console: Console, session: Session, curve: LearningCurve) -> LearnFacts:
    """Learn once more from the whole recording, as `towtank learn` does, and add the result to the curve."""
    _say(console, "second pass over the recording, as `towtank learn` takes a log")
    with Output().progress("second pass") as progress:
        learning = learn_recordings(session.known, [session.recording], progress=progress)
    curve.read(session.recording.duration, learning.estimate)
    return learn_facts(learning, learning.model, None, [session.recording])


def _say(console: Console, text: str, style: str = "") -> None:
    console.print(Text(text, style=style))


def _whole(console: Console, text: str) -> None:
    """Print a text that is to be copied, never wrapped."""
    console.print(Text(text), soft_wrap=True)


def _make_folder(output: Path) -> None:
    try:
        output.mkdir(parents=True, exist_ok=True)
    except FileExistsError as error:
        raise InputError(f"--output {output}: found a file, expected a folder; choose another place") from error
    except OSError as error:
        why = error.strerror
        raise InputError(f"--output {output}: cannot make this folder ({why}); choose another place") from error
    trial = output / ".trial"
    write_text(trial, "")
    trial.unlink()


def _document(
    session: Session, facts: LearnFacts, curve: LearningCurve, judged: Validation, files: list[Path], last: Moment
) -> dict[str, Any]:
    coefficients: dict[str, Any] = {}
    for each in facts.estimate.coefficients:
        truth = session.final.coefficient(each.name)
        entry = {"value": each.value, "std": each.std, "unit": each.unit, "identified": each.identified}
        errors = _errors(truth, each.value, each.std)
        coefficients[each.name] = {"truth": truth, **entry, "reason": each.reason, **errors}
    sums = {
        quantity.name: {
            "truth": quantity.truth,
            "value": value,
            "std": std,
            "unit": quantity.unit,
            "identified": value == value,
            **_errors(quantity.truth, value, std),
        }
        for quantity, value, std in curve.latest()
        if quantity.kind == "inertia"
    }
    return {
        "vehicle": session.truth.name,
        "seconds": session.recording.duration,
        "samples": last.samples,
        "seed": SEED,
        "method": facts.method,
        "delay_s": DELAY,
        "delay_learned_s": facts.delay,
        "delay_std_s": facts.delay_std,
        "coefficients": coefficients,
        "sums": sums,
        "events": events_document(curve.events),
        "fit": judged.fit,
        "files": files,
        "latency_ms": last.latency_ms,
        "samples_per_second": last.rate,
    }


def _errors(truth: float, value: float, std: float) -> dict[str, float | None]:
    """Return the error in percent of the truth and in deviations; None where it is not identified."""
    if not std > 0.0:
        return {"error_percent": None, "error_in_std": None}
    share = 100.0 * (value / truth - 1.0) if truth else None
    return {"error_percent": share, "error_in_std": (value - truth) / std}
