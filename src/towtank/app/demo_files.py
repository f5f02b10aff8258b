"""What the demo leaves behind: model, recordings, figures and page."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from towtank import __version__
from towtank.app.demo_progress import Course, convergence_of, quantities
from towtank.app.demo_session import Session
from towtank.app.demo_words import LOG, MODEL, UNSEEN, commands, setting, verdict
from towtank.app.figures import Trace, convergence_figure, png, prediction_figure
from towtank.outputs import write_atomically, write_text
from towtank.report import LearnFacts, Origin
from towtank.report.learn_page import report_html
from towtank.validation import Validation, residuals
from towtank.vehicle import save_vehicle

__all__ = ["write_demo"]

_CONVERGENCE, _PREDICTION, _PAGE = "convergence.png", "prediction.png", "demo.html"


def write_demo(
    output: Path, session: Session, unseen: Session, facts: LearnFacts, judged: Validation, course: Course
) -> list[Path]:
    """Write everything into the folder and return the files, the page first. facts: of what was learned."""
    save_vehicle(facts.model, output / MODEL)
    session.recording.write(output / LOG)
    unseen.recording.write(output / UNSEEN)
    t, values, std = np.array(course.t), np.array(course.values), np.array(course.std)
    first = quantities(session.truth, weight=session.later is not None)
    traces = [
        Trace(q.name, q.unit, q.axes, values[:, i], std[:, i], q.truth, _until(session, first[i].truth))
        for i, q in enumerate(course.learned)
    ]
    convergence = png(convergence_figure(t, traces, session.turns, "Estimates as the session goes on"))
    prediction = png(prediction_figure(judged.predictions[0], judged.fit, "Prediction of a session never seen"))
    for name, image in ((_CONVERGENCE, convergence), (_PREDICTION, prediction)):
        write_atomically(output / name, partial(_put, image))
    write_text(output / _PAGE, report_html(_facts(session, facts, judged, course)))
    return [output / name for name in (_PAGE, MODEL, LOG, UNSEEN, _CONVERGENCE, _PREDICTION)]


def _until(session: Session, value: float) -> tuple[float, float] | None:
    """Return until when [s] the truth was another one, and which; None where it was the same all along."""
    return None if session.later is None else (session.changed, value)


def _facts(session: Session, facts: LearnFacts, judged: Validation, course: Course) -> LearnFacts:
    """Return what the page tells: what was learned, beside the truth, with the course of the first pass."""
    next_ = [f"# {purpose}\n{command}" for purpose, command in commands(Path())]
    return replace(
        facts,
        title="A vehicle learned in a simulated tank",
        verdict=f"{verdict(course)}.",
        remarks=[setting(session), *facts.remarks],
        fit=judged.fit,
        rmse=judged.rmse,
        predictions=judged.predictions,
        residuals=residuals(judged.predictions),
        predicted="a session never seen, with other noise and other random forces",
        convergence=convergence_of(course, session.known),
        truth=session.final,
        truth_before=None if session.later is None else (session.changed, session.truth),
        events=course.events,
        origin=Origin(commands=next_, versions={"towtank": __version__}),
    )


def _put(data: bytes, stream: BinaryIO) -> None:
    stream.write(data)
