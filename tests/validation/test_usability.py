"""For how long a prediction is of use: by models that are right, wrong, or know nothing but the last value."""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np
import pytest

from towtank.recording import Recording, align
from towtank.report.verdict import usable_text, validate_verdict
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate
from towtank.validation import AxisUse, Prediction, Usability, predict, usability

from .test_prediction import box

YAW = 5
module = importlib.import_module("towtank.validation.usability")


def run(sensors: tuple[str, ...] = (), seconds: float = 60.0) -> Recording:
    """Surge and yaw pushed up and down under a random force; only these channels where any are named."""
    t = 0.01 * np.arange(round(100 * seconds))
    wrench = np.zeros((t.size, 6))
    wrench[:, 0] = 20.0 * np.sign(np.sin(0.6 * t))
    wrench[:, YAW] = 1.5 * np.sign(np.sin(0.9 * t + 1.0))
    force = OrnsteinUhlenbeck(std=(0.5, 0.1, 0.1, 0.01, 0.01, 0.05))
    whole = simulate(box(), wrench=wrench, dt=0.01, sensors=Mocap(), disturbance=force, seed=1)
    return Recording({name: whole[name] for name in sensors}) if sensors else whole


def axes(found: Usability) -> dict[str, AxisUse]:
    return {each.axis: each for each in found.axes}


def test_the_truth_predicts_what_was_driven_and_is_not_judged_by_what_was_not() -> None:
    found = usability(box(), [align(run())])
    assert axes(found).keys() == {"surge", "yaw"}
    assert axes(found)["surge"].channel == "u"  # motion capture has none: told by the pose
    assert axes(found)["surge"].fit > 80.0
    assert found.seconds >= 10.0
    assert found.undriven == ("sway", "heave", "roll", "pitch")
    assert usable_text(found).grade == "good"


def test_a_prediction_that_has_been_made_is_not_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, asked = align(run()), list[float | None]()
    free = [predict(box(), grid)]
    whole = usability(box(), [grid])

    def counted(*given: Any, horizon: float | None = None, **more: Any) -> Prediction:
        asked.append(horizon)
        return predict(*given, horizon=horizon, **more)

    monkeypatch.setattr(module, "predict", counted)
    assert usability(box(), [grid], free=free) == whole
    assert asked
    assert None not in asked


def test_a_model_that_pushes_the_other_way_is_of_no_use() -> None:
    turned = run().replace([])
    backwards = [turned[name].with_values(-turned[name].values) for name in ("X", "N")]
    found = usability(box(), [align(turned.replace(backwards))])
    assert not found.good
    assert all(each.seconds == 0.0 and each.fit < 0.0 for each in found.axes)
    assert usable_text(found).text.startswith("Not usable for prediction: surge and yaw")


def test_a_model_that_hardly_moves_is_no_better_than_the_last_value() -> None:
    heavy = box().model_copy(update={"rigid_body": box().rigid_body.model_copy(update={"mass": 4000.0})})
    [surge] = [each for each in usability(heavy, [align(run())]).axes if each.axis == "surge"]
    assert surge.seconds <= 1.0  # after a second little has changed, and half is explained by where it began


def test_a_moment_tells_nothing() -> None:
    found = usability(box(), [align(run().window(0.0, 1.2))])
    assert not found.good
    assert usable_text(found).text == "Not usable for prediction: 1.2 s are too short to tell"


def test_attitude_alone_is_enough_to_predict_from() -> None:
    whole = run()
    shown = Recording({name: whole[name] for name in ("phi", "theta", "psi", *"XYZKMN")})
    found = usability(box(), [align(shown)])
    assert axes(found)["yaw"].fit > 80.0
    assert found.unmeasured == ("surge",)


def test_depth_alone_tells_of_heave() -> None:
    t = 0.01 * np.arange(6000)
    wrench = np.zeros((t.size, 6))
    wrench[:, 2] = 15.0 * np.sign(np.sin(0.5 * t))
    whole = simulate(box(), wrench=wrench, dt=0.01, sensors=Mocap(), seed=2)
    shown = Recording({name: whole[name] for name in ("z", "phi", "theta", *"XYZKMN")})
    assert {each.axis: each.channel for each in usability(box(), [align(shown)]).axes} == {"heave": "w"}


@pytest.mark.parametrize(
    ("axes", "undriven", "said"),
    [
        ([("surge", math.inf, 90.0)], (), "Usable for prediction over whole runs (surge)"),
        ([("surge", 30.0, 60.0), ("yaw", 5.0, 20.0)], (), "Usable for prediction up to 5 s (surge and yaw)"),
        (
            [("surge", math.inf, 60.0), ("yaw", 5.0, 20.0)],
            (),
            "Usable for prediction up to 5 s (yaw) and over whole runs (surge)",
        ),
        (
            [("surge", 30.0, 60.0), ("heave", 0.0, -3.0)],
            (),
            "Usable for surge (up to 30 s); not usable for heave (predicted worse than by its mean)",
        ),
        (
            [("heave", 0.0, 20.0)],
            (),
            "Not usable for prediction: heave (less than half of its motion is explained)",
        ),
        ([], ("surge",), "Not usable for prediction: no axis was driven"),
    ],
)
def test_the_words(axes: list[tuple[str, float, float]], undriven: tuple[str, ...], said: str) -> None:
    use = Usability(tuple(AxisUse(name, "u", seconds, fit) for name, seconds, fit in axes), undriven, (), 90.0)
    assert usable_text(use).text == said


def test_a_verdict_judges_by_the_axes_that_were_driven() -> None:
    use = Usability((AxisUse("surge", "u", math.inf, 91.0),), ("yaw",), (), 60.0)
    found = validate_verdict("mine", {"u": 91.0, "psi": -400.0}, [], use)
    assert found.grade == "good"
    assert found.text == "Usable for prediction over whole runs (surge). mine predicts surge speed (fit 91 %)."


@pytest.mark.parametrize(("fit", "reach"), [(79.6, 1), (79.4, 0)])
def test_a_fit_is_counted_as_it_is_printed(fit: float, reach: int) -> None:
    """At sea "surge speed best (fit 80 %)" stood beside "0 of 6 reach a fit of 80 %"."""
    found = validate_verdict("mine", {"u": fit, "r": 60.0}, [])
    assert f"surge speed best (fit {fit:.0f} %)" in found.text
    assert f"{reach} of 2 reach a fit of 80 %" in found.text


def test_predictions_of_pushes_are_told_at_the_horizon_asked_for() -> None:
    grid = align(run())
    [often] = [each for each in usability(box(X_uu=-10.0), [grid], horizon=1.0).axes if each.axis == "surge"]
    [never] = [each for each in usability(box(X_uu=-10.0), [grid]).axes if each.axis == "surge"]
    assert often.fit > never.fit
    assert often.seconds == never.seconds
