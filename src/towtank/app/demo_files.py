"""What the demo leaves behind: model, recordings, figures and page."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from towtank import __version__
from towtank.app.demo_progress import Course
from towtank.app.demo_session import Session
from towtank.app.demo_words import LOG, MODEL, UNSEEN, commands, setting, verdict
from towtank.app.figures import Trace, convergence_figure, png, prediction_figure
from towtank.app.learn_facts import learn_facts
from towtank.identification import LogLearning
from towtank.identification.convergence import Convergence
from towtank.outputs import write_atomically, write_text
from towtank.report import LearnFacts, Origin
from towtank.report.learn_page import report_html
from towtank.validation import Validation
from towtank.vehicle import index, save_vehicle

__all__ = ["write_demo"]

_CONVERGENCE, _PREDICTION, _PAGE = "convergence.png", "prediction.png", "demo.html"


def write_demo(
    output: Path, session: Session, unseen: Session, learning: LogLearning, judged: Validation, course: Course
) -> list[Path]:
    """Write everything into the folder and return the files, the page first."""
    save_vehicle(learning.model, output / MODEL)
    session.recording.write(output / LOG)
    unseen.recording.write(output / UNSEEN)
    t, values, std = np.array(course.t), np.array(course.values), np.array(course.std)
    traces = [Trace(q.name, q.unit, q.axes, values[:, i], std[:, i], q.truth) for i, q in enumerate(course.learned)]
    convergence = png(convergence_figure(t, traces, session.turns, "Estimates as the session goes on"))
    prediction = png(prediction_figure(judged.predictions[0], judged.fit, "Prediction of a session never seen"))
    for name, image in ((_CONVERGENCE, convergence), (_PREDICTION, prediction)):
        write_atomically(output / name, partial(_put, image))
    write_text(output / _PAGE, report_html(_facts(session, learning, judged, course)))
    return [output / name for name in (_PAGE, MODEL, LOG, UNSEEN, _CONVERGENCE, _PREDICTION)]


def _facts(session: Session, learning: LogLearning, judged: Validation, course: Course) -> LearnFacts:
    """Return what the page tells: the report of the second pass, beside the truth, with the course of the first."""
    facts = learn_facts(learning, learning.model, judged, [session.recording])
    next_ = [f"# {purpose}\n{command}" for purpose, command in commands(Path())]
    return replace(
        facts,
        title="A vehicle learned in a simulated tank",
        verdict=f"{verdict(course)}.",
        remarks=[setting(session.recording.duration), *facts.remarks],
        predicted="a session never seen, with other noise and other random forces",
        convergence=_convergence(session, course),
        truth=session.truth,
        origin=Origin(commands=next_, versions={"towtank": __version__}),
    )


def _convergence(session: Session, course: Course) -> Convergence:
    """Return the course as that of coefficients: of the inertias without the rigid body's."""
    values = np.array(course.values)
    rigid = np.diag(session.known.rigid_body_matrix)
    for k, quantity in enumerate(course.learned):
        if quantity.kind == "inertia":
            values[:, k] = rigid[index(quantity.coefficient)[1]] - values[:, k]
    names = tuple(quantity.coefficient for quantity in course.learned)
    return Convergence(names, np.array(course.t), values, np.array(course.std))


def _put(data: bytes, stream: BinaryIO) -> None:
    stream.write(data)
