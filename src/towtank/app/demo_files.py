"""What the demo leaves behind: model, recordings, figures and page."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from towtank.app.demo_page import demo_page
from towtank.app.demo_progress import Course
from towtank.app.demo_session import Session
from towtank.app.demo_words import LOG, MODEL, UNSEEN, commands, setting, verdict
from towtank.app.figures import Trace, convergence_figure, png, prediction_figure
from towtank.outputs import write_atomically, write_text
from towtank.validation import Validation
from towtank.vehicle import Vehicle, save_vehicle

__all__ = ["write_demo"]

_CONVERGENCE, _PREDICTION, _PAGE = "convergence.png", "prediction.png", "demo.html"
_SETTLED = (
    "One sample at a time. Shaded: the axis' own turn. The band is twice the estimate's own standard deviation, the "
    "dashed line the truth in the simulator. The second pass, at the right edge, gives the values of the table."
)
_PREDICTED = (
    "All axes at once, other noise and other random forces. The model starts from one measured state and is then "
    "driven by the commands alone; what is left is mostly the random forces, which no model can know."
)


def write_demo(
    output: Path, session: Session, unseen: Session, model: Vehicle, judged: Validation, course: Course
) -> list[Path]:
    """Write everything into the folder and return the files, the page first."""
    save_vehicle(model, output / MODEL)
    session.recording.write(output / LOG)
    unseen.recording.write(output / UNSEEN)
    t, values, std = np.array(course.t), np.array(course.values), np.array(course.std)
    traces = [Trace(q.name, q.unit, q.axes, values[:, i], std[:, i], q.truth) for i, q in enumerate(course.learned)]
    convergence = png(convergence_figure(t, traces, session.turns, "Estimates as the session goes on"))
    prediction = png(prediction_figure(judged.predictions[0], judged.fit, "Prediction of a session never seen"))
    for name, image in ((_CONVERGENCE, convergence), (_PREDICTION, prediction)):
        write_atomically(output / name, partial(_put, image))
    figures = (
        ("How the estimates settled", _SETTLED, convergence),
        ("Prediction of a session never seen", _PREDICTED, prediction),
    )
    page = demo_page(f"{verdict(course)}.", course, figures, setting(session.recording.duration), commands(Path()))
    write_text(output / _PAGE, page)
    return [output / name for name in (_PAGE, MODEL, LOG, UNSEEN, _CONVERGENCE, _PREDICTION)]


def _put(data: bytes, stream: BinaryIO) -> None:
    stream.write(data)
