"""Numbers, documents, windows and plots of characters."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from towtank.app.commands.arguments import Window, numbers
from towtank.app.tables.thrusters import text_plot
from towtank.app.terminal.output import json_text, plain
from towtank.digits import measured, short
from towtank.errors import InputError
from towtank.recording import Recording

RECORDING = Recording.from_table(np.linspace(0.0, 100.0, 11), {"u": np.zeros(11)})


@pytest.mark.parametrize(
    "value, std, expected",
    [
        (-0.77105, 0.05246, ("-0.771", "0.052")),
        (40.421, 0.064, ("40.421", "0.064")),
        (1234.5, 37.0, ("1234", "37")),
        (-3.93, 0.0, ("-3.93", "0")),
        (-3.93, None, ("-3.93", "")),
        (-3.93, math.nan, ("-3.93", "")),
        (-19.5191234, 2e-9, ("-19.5191", "2e-09")),
        (0.0, 0.5, ("0.00", "0.50")),
        (0.01, 12.0, ("0", "12")),
    ],
)
def test_value_and_deviation(value: float, std: float | None, expected: tuple[str, str]) -> None:
    assert measured(value, std) == expected


@given(st.floats(-1e9, 1e9), st.floats(1e-12, 1e9))
def test_value_and_deviation_are_numbers(value: float, std: float) -> None:
    text, spread = measured(value, std)
    assert float(text) == pytest.approx(value, abs=std + 1e-5 * abs(value))
    assert float(spread) == pytest.approx(std, rel=0.5, abs=0.51)


@given(st.floats(-1e300, 1e300) | st.sampled_from([math.nan, math.inf, -math.inf]))
def test_short_is_short(value: float) -> None:
    text = short(value)
    assert len(text) <= 11
    assert text == "-" if math.isnan(value) else float(text) == pytest.approx(value, rel=1e-3, abs=0.51)


def test_document_has_no_nan() -> None:
    found = plain(
        {"a": math.nan, "b": [math.inf, np.float64(1.0)], "c": np.array([1.0, np.nan]), "d": Path("x"), 1: None}
    )
    assert found == {"a": None, "b": [None, 1.0], "c": [1.0, None], "d": "x", "1": None}
    assert json.loads(json_text(found)) == found


def test_document_refuses_what_it_does_not_know() -> None:
    with pytest.raises(TypeError, match="object"):
        plain({"a": object()})


@pytest.mark.parametrize(
    "text, stretch",
    [
        ("10,60", (10.0, 60.0)),
        (" 10 , 60 ", (10.0, 60.0)),
        ("10,", (10.0, math.inf)),
        (",60", (-math.inf, 60.0)),
        ("-30,", (70.0, math.inf)),
        ("10,-10", (10.0, 90.0)),
        ("-30,-10", (70.0, 90.0)),
    ],
)
def test_window(text: str, stretch: tuple[float, float]) -> None:
    window = Window.parse(text)
    assert window is not None
    assert window.within(RECORDING) == stretch


def test_negative_times_stay_where_the_clock_has_them() -> None:
    early = Recording.from_table(np.linspace(-100.0, 0.0, 11), {"u": np.zeros(11)})
    window = Window.parse("-30,-10")
    assert window is not None
    assert window.within(early) == (-30.0, -10.0)


@pytest.mark.parametrize("text", ["", ",", "10", "1,2,3", "a,b", "60,10", "10,10", "nan,5", "-10,-30", "1;2"])
def test_wrong_windows(text: str) -> None:
    with pytest.raises(InputError, match=r"^--window: found "):
        Window.parse(text)


def test_numbers_of_an_option() -> None:
    assert numbers("--current", "0.2,-0.1,0", 3, "three") == (0.2, -0.1, 0.0)
    assert numbers("--current", None, 3, "three") is None
    with pytest.raises(InputError, match='--current: found "1,2", expected three'):
        numbers("--current", "1,2", 3, "three")


def test_text_plot() -> None:
    x = np.linspace(-1.0, 1.0, 21)
    lines = text_plot((x, x**3), (x, x**3), x_name="command", y_name="force N")
    assert len(lines) == 17
    assert max(map(len, lines)) <= 79
    assert lines[1].endswith("o")
    assert lines[-2].lstrip().startswith("-1 |o")
    assert text_plot((x, 0.0 * x), (x, 0.0 * x), x_name="x", y_name="y") == []
