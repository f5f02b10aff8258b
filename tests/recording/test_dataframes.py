"""A recording in NumPy, pandas and xarray, and as notebooks show it."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.recording import Channel, Recording, standard_channel


@pytest.fixture
def run() -> Recording:
    fast, slow = np.arange(0.0, 1.0, 0.1), np.arange(0.0, 1.0, 0.25)
    channels = [standard_channel("u", fast, np.sin(fast)), standard_channel("z", slow, slow + 1.0)]
    return Recording({each.name: each for each in channels}, source="dive <1>.csv")


def test_numpy_takes_a_channel_as_its_values(run: Recording) -> None:
    values = np.asarray(run["u"])
    assert values is run["u"].values
    assert np.mean(run["u"]) == pytest.approx(np.sin(run["u"].t).mean())
    assert np.asarray(run["u"], dtype=np.float32).dtype == np.float32
    copy = np.array(run["u"])
    copy[:] = 0.0
    assert run["u"].values[1] != 0.0
    with pytest.raises(KeyError, match=r"no channel .*; there are u z"):
        run["nix"]


def test_texts_are_short(run: Recording) -> None:
    assert repr(run["u"]) == "<Channel u: 10 samples, 0 .. 0.9 s, 0 .. 0.7833, m/s FRD>"
    assert repr(Channel("a", np.empty(0), np.empty(0))) == "<Channel a: empty>"
    assert "u z" in repr(run)
    html = run._repr_html_()
    assert "dive &lt;1&gt;.csv" in html
    assert html.count("<polyline") == 2
    assert "m/s" in html


def test_a_plot_of_many_samples_keeps_its_spikes() -> None:
    t = np.arange(0.0, 100.0, 0.01)
    values = np.zeros(t.size)
    values[5000] = 7.0
    run = Recording.from_table(t, {"u": values})
    html = run._repr_html_()
    points = html.split('points="')[1].split('"')[0].split()
    assert len(points) == 160
    heights = [float(point.split(",")[1]) for point in points]
    assert min(heights) == pytest.approx(2.0)
    assert heights.count(min(heights)) == 1


def test_pandas_has_every_time_and_nothing_in_between(run: Recording) -> None:
    pandas = pytest.importorskip("pandas")
    frame = run.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame.index.name == "t"
    assert list(frame.columns) == ["u", "z"]
    for name in run:
        kept = frame[name].dropna()
        assert np.array_equal(kept.index, run[name].t)
        assert np.array_equal(kept, run[name].values)
    assert frame.attrs["units"] == {"u": "m/s", "z": "m"}
    frame.loc[:, "u"] = 0.0
    assert run["u"].values[1] != 0.0


def test_xarray_bears_units_frames_and_meanings(run: Recording) -> None:
    pytest.importorskip("xarray")
    data = run.to_xarray()
    assert dict(data.sizes) == {"t": 12}
    assert data["u"].attrs == {
        "units": "m/s",
        "frame": "FRD",
        "long_name": "surge velocity of the body origin over ground",
    }
    assert float(data["z"].sel(t=0.5)) == 1.5
    assert np.isnan(float(data["u"].sel(t=0.25)))


@pytest.mark.parametrize(("method", "library"), [("to_pandas", "pandas"), ("to_xarray", "xarray")])
def test_a_library_that_is_missing_is_named_with_its_extra(
    run: Recording, method: str, library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=rf'{method}: {library} is not installed; pip install "towtank\[notebook\]"'):
        getattr(run, method)()


def test_a_notebook_shows_what_holds_and_how_many_gaps_there_are() -> None:
    t = np.delete(np.arange(100) / 10.0, slice(40, 60))
    shown = Recording.from_table(t, {"u": np.sin(t), "cmd_1": np.sign(np.sin(t))}, source="a.csv")._repr_html_()
    rows = [row for row in re.split("<tr", shown) if "over time" in row]
    cells = [re.sub("<svg.*</svg>|<[^>]*>", " ", row).split() for row in rows]
    named = {each[1] if each[0].endswith(">") else each[0]: each for each in cells}
    assert "held" in " ".join(named["cmd_1"])
    assert "held" not in " ".join(named["u"])
    assert "1" in named["u"]
    assert f"a.csv: {t[-1]:.3f} s, 2 channels" in shown
