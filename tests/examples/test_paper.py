"""The paper reproduced: Table I to every digit, the pitch error, the errors of the real chain, the figures."""

from __future__ import annotations

import importlib
import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import matplotlib as mpl
import pytest

mpl.use("Agg")

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDER = REPOSITORY / "examples" / "paper"
IMAGES = REPOSITORY / "docs" / "images" / "paper"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what imports a script of the example as it runs: from its own folder."""
    monkeypatch.syspath_prepend(str(FOLDER))

    def load(name: str) -> ModuleType:
        return importlib.import_module(name)

    return load


@pytest.mark.parametrize("inputs", ["smooth", "held"])
def test_table_1_to_every_printed_digit(script: Any, inputs: str) -> None:
    table1 = script("table1")
    case = table1.identify(table1.fly(table1.truth(), inputs), inputs, 2.0)
    assert len(case.rows) == 12
    assert case.exact == 12
    assert case.worst <= 1e-6
    assert case.righting.error <= 1e-6
    assert case.holds


def test_printed_digits_are_counted_from_the_left(script: Any) -> None:
    digits = script("table1").digits
    assert digits(-79.41099922, "-79.411") == 5
    assert digits(-82.363, "-79.411") == 0
    assert digits(-58.77, "-56.61") == 1
    assert digits(-0.1540000, "-0.154") == 3
    assert digits(-0.1546, "-0.154") == 2
    assert digits(-127.08, "-27.08") == 0


def test_a_moment_left_out_of_pitch_makes_the_error_of_table_1(script: Any) -> None:
    pitch = script("pitch_error")
    left_out = pitch.identify(*pitch.GENTLE, -0.703)
    assert left_out.largest_pitch < 20.0
    assert left_out.error("M_qdot") == pytest.approx(3.7, abs=0.5)
    assert left_out.error("M_qq") == pytest.approx(3.8, abs=0.5)
    righting = pitch.identify(*pitch.GENTLE, 0.703)
    assert righting.error("M_qdot") < -2.0

    tumbling = pitch.identify(*pitch.TUMBLING, 2.219)
    assert tumbling.from_paper < 0.5

    mended = pitch.identify(*pitch.GENTLE, -0.703, third=True)
    assert abs(mended.error("M_qdot")) < 1e-4
    assert abs(mended.error("M_qq")) < 1e-4
    assert mended.BG_z == pytest.approx(-0.703, abs=1e-6)


def test_errors_of_the_chain_are_those_told_in_the_documentation(script: Any) -> None:
    errors = script("errors")
    found = {case.name: errors.examine(case, runs=2) for case in errors.CASES if not case.conditions.random}

    def bias(name: str) -> tuple[float, float]:
        mass, drag = found[name].mean["paper-stairs"]
        return mass, drag

    assert bias("none: exact velocity, exact regressors") == pytest.approx((0.0, 0.0), abs=0.01)
    assert bias("delay of 200 ms, known") == pytest.approx((0.0, 0.0), abs=0.01)
    assert bias("low-pass on the velocity only") == pytest.approx((8.1, -2.6), abs=0.2)
    assert bias("low-pass on velocity and thrust") == pytest.approx((0.0, 0.0), abs=0.2)
    assert bias("delay of 200 ms, not known") == pytest.approx((10.9, -3.8), abs=0.2)
    assert bias("thrust curve 5 % too strong") == pytest.approx((5.0, 5.0), abs=0.01)


def test_the_whole_chain_spoils_the_papers_way_and_not_towtank(script: Any) -> None:
    errors = script("errors")
    paper, stream = (case for case in errors.CASES if case.name.startswith(("all of", "all, Paper")))
    spoiled, mended = (errors.examine(case, runs=3).mean["paper-square"] for case in (paper, stream))
    assert spoiled[0] > 15.0
    assert spoiled[1] < -30.0
    assert abs(mended[0]) < 2.0
    assert abs(mended[1]) < 6.0


def test_json_is_one_object(script: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    table1 = script("table1")
    monkeypatch.setattr(table1, "FILTERS", (2.0,))
    monkeypatch.setattr(table1, "INPUTS", {"held": "held"})
    assert table1.main(["--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["holds"] is True
    assert {row["name"] for row in document["cases"][0]["rows"]} == set(table1.TABLE_I)


def test_figures_are_drawn(script: Any, tmp_path: Path) -> None:
    figures = script("figures")
    names = ["figure-04-thruster-curve", "figure-07-surge-convergence"]
    for path in figures.draw(tmp_path, names):
        assert 2_000 < path.stat().st_size < 80_000
        assert path.read_bytes().startswith(b"\x89PNG")


def test_every_figure_of_the_documentation_is_one_of_the_script(script: Any) -> None:
    names = set(script("figures").FIGURES)
    assert {path.stem for path in IMAGES.glob("*.png")} == names
    page = (REPOSITORY / "docs" / "paper.md").read_text(encoding="utf-8")
    assert all(f"images/paper/{name}.png" in page for name in names)


def test_mass_and_drag_of_the_tables_are_finite(script: Any) -> None:
    tank = script("tank")
    vehicle = tank.tank_vehicle()
    for axis in tank.AXES:
        mass, drag = tank.true_values(vehicle, axis)
        changed = tank.with_values(vehicle, axis, 2.0 * mass, 3.0 * drag)
        assert tank.true_values(changed, axis) == pytest.approx((2.0 * mass, 3.0 * drag))
        assert math.isfinite(mass)
