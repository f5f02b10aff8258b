"""Channels and recordings: frozen, validated, windowed."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.recording import STANDARD, Channel, Content, Recording, Repairs, standard_channel

T = np.arange(10) / 10.0


def make() -> Recording:
    columns = {"u": np.arange(10.0), "cmd_port": np.repeat([1.0, 2.0], 5)}
    return Recording.from_table(T, columns, source="test")


def test_every_standard_channel_states_unit_frame_and_meaning() -> None:
    for name, standard in STANDARD.items():
        assert standard.unit, name
        assert standard.frame in {"NED", "FRD", "NED-FRD", ""}, name
        assert standard.description, name


def test_arrays_are_read_only_and_do_not_alias_the_callers() -> None:
    t, values = T.copy(), np.ones(10)
    channel = standard_channel("u", t, values)
    values[0] = t[0] = -5.0
    assert channel.values[0] == 1.0
    assert channel.t[0] == 0.0
    with pytest.raises(ValueError):
        channel.values[0] = 2.0
    with pytest.raises(ValueError):
        make()["u"].t[0] = 2.0
    view = np.ones(10)[:]
    view.flags.writeable = False
    assert standard_channel("u", T, view).values is not view


def test_a_part_of_what_nobody_can_write_to_is_not_copied() -> None:
    whole = np.arange(20.0)
    whole.flags.writeable = False
    assert np.shares_memory(standard_channel("u", T, whole[5:15]).values, whole)


@pytest.mark.parametrize(
    ("t", "values", "found"),
    [
        ([0.0, 1.0], [1.0], "two arrays of one length"),
        ([[0.0, 1.0]], [[1.0, 1.0]], "two arrays of one length"),
        ([0.0, np.nan], [1.0, 1.0], "every time must be finite"),
        ([0.0, 1.0, 1.0], [1.0, 1.0, 1.0], "time must increase, found 1.0 s and then 1.0 s (sample 2)"),
        ([0.0, 1.0], [1.0, np.inf], "infinite"),
        ([0.0, 1.0], ["a", "b"], "must be numbers"),
    ],
)
def test_a_channel_refuses_what_is_not_one(t: object, values: object, found: str) -> None:
    with pytest.raises(InputError) as error:
        Channel("u", t, values, "m/s", "FRD")  # type: ignore[arg-type]
    assert found in str(error.value)
    assert '"u"' in str(error.value)


def test_a_standard_name_admits_only_its_own_unit() -> None:
    with pytest.raises(InputError, match='found unit "deg"'):
        Channel("phi", T, T, "deg", "NED-FRD")
    assert Channel("pressure", T, T, "Pa").unit == "Pa"
    with pytest.raises(InputError, match='unknown channel "ph"; did you mean "phi"'):
        standard_channel("ph", T, T)


def test_access() -> None:
    run = make()
    assert "u" in run
    assert "v" not in run
    assert run.names == ("u", "cmd_port")
    assert (run.start, run.end) == (0.0, 0.9)
    assert run.duration == pytest.approx(0.9)
    assert run["cmd_port"].unit == "command"
    assert run["u"].t is run["cmd_port"].t
    assert "0.900 s" in repr(run)
    with pytest.raises(AttributeError):
        run.source = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        run.channels["v"] = run["u"]  # type: ignore[index]


def test_from_table_gives_each_channel_the_times_where_it_is_measured() -> None:
    slow = np.where(np.arange(10) % 3 == 0, 1.0, np.nan)
    run = Recording.from_table(T, {"u": T, "v": slow, "w": slow, "p": np.full(10, np.nan)})
    assert np.array_equal(run["v"].t, T[::3])
    assert run["v"].t is run["w"].t
    assert run.names == ("u", "v", "w")
    assert 'channel "p" holds no value; left out' in run.notes


def test_a_recording_needs_a_sample_and_right_names() -> None:
    with pytest.raises(InputError, match="at least one channel"):
        Recording({})
    with pytest.raises(InputError, match="at least one channel"):
        Recording.from_table(T, {"u": np.full(10, np.nan)})
    with pytest.raises(InputError, match='stands under the name "v"'):
        Recording({"v": make()["u"]})


def test_replace_without_and_pickle() -> None:
    run = make()
    both = run.replace([standard_channel("v", T, T), run["u"].with_values(-T)])
    assert both.names == ("u", "cmd_port", "v")
    assert both["u"].values[3] == -T[3]
    assert run["u"].values[3] == 3.0
    assert run.replace({"u": run["u"]}) == run
    assert both.without("u", "v").names == ("cmd_port",)
    noted = run.with_notes("a", repairs=Repairs(spikes=2))
    again = pickle.loads(pickle.dumps(noted))
    assert again == noted
    assert not again["u"].values.flags.writeable
    assert noted != run


def test_a_window_restates_the_command_in_force() -> None:
    cut = make().window(0.25, 0.6)
    assert np.array_equal(cut["u"].t, T[3:7])
    assert cut["cmd_port"].t[0] == 0.25
    assert cut["cmd_port"].values[0] == 1.0
    sparse = make().replace([standard_channel("cmd_port", [0.0], [7.0])]).window(0.5, 0.9)
    assert (sparse["cmd_port"].t[0], sparse["cmd_port"].values[0]) == (0.5, 7.0)
    exact = make().window(0.2, 0.6)
    assert np.array_equal(exact["cmd_port"].t, T[2:7])


def test_a_window_without_samples_is_refused() -> None:
    with pytest.raises(InputError, match=r"test: window 5,6: no sample in it; the recording goes from 0 to 0.9 s"):
        make().window(5.0, 6.0)
    with pytest.raises(InputError, match="end before the start"):
        make().window(0.6, 0.2)
    late = make().replace([standard_channel("v", [5.0, 6.0], [0.0, 0.0])])
    assert late.window(0.0, 1.0).notes == ("no samples within 0..1 s: v",)


def test_repairs_add_up_and_explain_themselves() -> None:
    total = Repairs(spikes=1, details=("1 spike in u",)) + Repairs(spikes=2, dead=("r",), disorder=1)
    assert total.spikes == 3
    assert "3 spikes" in total.summary
    assert "1 sample out of order (sorted)" in total.summary
    assert "dead: r" in total.summary
    assert bool(total)
    assert not Repairs()
    assert Repairs().summary == "nothing to repair"


def test_contents_are_kept_by_all_that_makes_another_recording() -> None:
    contents = (Content("IMU[0]", "DataFlash", 5, 25.0, ("p",), "rates: why"), Content("PM", "DataFlash", 1, None))
    t = np.arange(5.0)
    run = Recording({"p": standard_channel("p", t, t)}, source="log", contents=contents)
    assert run.window(1.0, 3.0).contents == contents
    assert run.with_notes("a note").contents == contents
    assert run.replace([standard_channel("q", t, t)]).contents == contents
    assert run.replace([standard_channel("q", t, t)]).without("p").contents == contents
    assert pickle.loads(pickle.dumps(run)) == run
    assert run != Recording({"p": standard_channel("p", t, t)}, source="log")
