"""The report of `towtank validate`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.report.sections.prediction import growth
from towtank.validation import Prediction

from .conftest import Made
from .pages import numbers_agree


def test_every_section_is_there(judged: Made) -> None:
    judged.page.self_contained()
    assert judged.page.sections == ["prediction", "errors", "residuals", "log", "vehicle", "origin"]
    assert "How the error grows over the horizon" in judged.page.text
    assert "--horizon 3" in judged.page.html


def test_every_number_is_that_of_json(judged: Made) -> None:
    keys = numbers_agree(judged.page, judged.document)
    for name, value in judged.document["fit"].items():
        assert (f"fit/{name}" in keys) is (value is not None)
        assert (f"rmse/{name}" in keys) is (value is not None)
    assert {"window/0", "window/1", "horizon_s"} <= keys
    assert {f"residuals/{name}/samples" for name in judged.document["residuals"]} <= keys


def test_several_models(make: Any, logs: Path, learned: Made) -> None:
    model = logs / "learned.toml"
    made = make("several", "validate", model, logs / "yaw.csv", "--against", "vlbv300")
    keys = numbers_agree(made.page, made.document)
    place = str(model).replace("/", "~1")
    assert {f"comparison/fit/{place}/r", "comparison/fit/vlbv300/r", "comparison/rmse/vlbv300/r"} <= keys
    assert "comparison" in made.page.sections


def test_folds(make: Any, logs: Path) -> None:
    words = ("validate", "vlbv300", logs / "yaw.csv", "--folds", 3, "--method", "paper", "--delay", 0)
    made = make("folds", *words)
    keys = numbers_agree(made.page, made.document)
    assert {f"cross_validation/folds/{k}/fit/r" for k in range(3)} <= keys
    assert "cross_validation/coefficients/N_rr/folds_std" in keys
    assert "Coefficients over the folds" in made.page.text


def test_the_error_grows_from_nothing_after_each_restart() -> None:
    t = np.arange(0.0, 10.01, 0.01)
    since = np.where(t == 0.0, 0.0, np.mod(t - 1e-9, 2.0))
    prediction = Prediction(t, {"u": (since, np.zeros(t.size))}, (0.0, 2.0, 4.0, 6.0, 8.0))
    time, rms = growth([prediction], "u")
    assert time[-1] == pytest.approx(1.975, abs=0.01)
    assert np.allclose(rms, time, atol=0.03)
    assert growth([prediction], "v")[0].size == 0
