"""Clocks of a ROS recording: stamps and times of recording that differ by days, drift, or run at another rate."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.readers.common.tables import Table
from towtank.readers.ros.clock import reconciled

N = 2000
TRUE = 0.02 * np.arange(N)
DAYS = 514_944.044


def table(name: str, offset: float | None, *, rate: float = 1.0, late: float = 0.004, seed: int = 0) -> Table:
    """Messages stamped at TRUE on a clock behind by `offset`, recorded later by exponential delays."""
    delays = np.random.default_rng(seed).exponential(late, N) + 0.0003
    stamp = None if offset is None else TRUE * rate - offset
    return Table(name, TRUE + delays, {"x": TRUE}, "k/msg/K", stamp=stamp)


@pytest.mark.parametrize("offset", [0.0, 0.2, -3.5, DAYS, -DAYS])
def test_one_clock_for_all_stamps(offset: float) -> None:
    """What the recorder's delays did to the times is undone, to the quickest message of each topic."""
    a, b, c = table("/a", offset), table("/b", offset, late=0.03, seed=1), table("/c", None, seed=2)
    found = reconciled([a, b, c])
    times = {each.name: each.t for each in found.tables}
    assert np.allclose(np.diff(times["/a"]), 0.02, atol=1e-6)
    assert np.abs(times["/a"] - times["/b"]).max() < 1e-6
    assert np.abs(times["/a"] - TRUE).max() < 0.002
    assert np.array_equal(times["/c"], c.t)
    assert not found.simulated
    if abs(offset) < 0.1:
        assert not found.notes
    elif offset == DAYS:
        assert found.notes[0].startswith("stamps of the messages are 5.96 days (514944.04")
        assert "behind the recorder's clock" in found.notes[0]
    else:
        assert ("behind" if offset > 0 else "ahead of") in found.notes[0]


def test_a_topic_with_a_clock_of_its_own_is_named() -> None:
    found = reconciled([table("/a", 0.0), table("/b", 0.0, seed=1), table("/dvl", 7.5, seed=2)])
    assert [note for note in found.notes if "/dvl: its stamps are 7.5" in note]
    assert np.abs(found.tables[2].t - TRUE).max() < 0.002


def test_drift_is_followed_and_told() -> None:
    found = reconciled([table("/a", 0.0), table("/b", 0.0, seed=1), table("/c", 0.0, rate=1.0 - 400e-6, seed=3)])
    assert np.abs(found.tables[2].t - TRUE).max() < 0.003
    [told] = [note for note in found.notes if "ppm" in note]
    assert told.startswith("/c: its clock runs -")
    assert float(told.split()[4]) == pytest.approx(-400.0, rel=0.1)


def test_a_simulation_that_runs_slower_than_the_clock() -> None:
    """The stamps are the time that the physics knows; commands without stamps follow the others."""
    truth = 0.4 * TRUE
    stamped = Table("/odom", TRUE + 0.001, {"x": truth}, stamp=truth + 30.0)
    unstamped = Table("/thrusters", TRUE + 0.001, {"x": truth})
    found = reconciled([stamped, unstamped])
    assert found.simulated
    assert np.allclose(found.tables[0].t, truth, atol=1e-9)
    assert np.allclose(found.tables[1].t, truth, atol=1e-6)
    assert any("0.4 times the recorder's clock, as in a simulation" in note for note in found.notes)


@pytest.mark.parametrize(
    ("stamp", "why"),
    [
        (np.where(np.arange(N) % 3 == 0, np.nan, TRUE), "most of its stamps are missing"),
        (np.repeat(TRUE[::4], 4), "do not increase"),
        (TRUE + 3.0 * np.sin(TRUE / 5.0), "wander against the times of recording"),
    ],
)
def test_stamps_of_no_use(stamp: np.ndarray, why: str) -> None:
    odd = Table("/odd", TRUE + 0.01, {}, stamp=stamp)
    found = reconciled([table("/a", 5.0), odd])
    assert np.array_equal(found.tables[1].t, odd.t)
    assert any("/odd" in note and why in note for note in found.notes)


def test_a_few_messages_keep_their_times() -> None:
    few = Table("/few", np.array([1.0, 2.0]), {}, stamp=np.array([-100.0, -99.0]))
    assert reconciled([few]).tables[0] is few


@pytest.mark.parametrize(
    "offset, words",
    [
        (0.2, "0.200 s behind"),
        (-0.2, "0.200 s ahead of"),
        (172_799.0, "172799.000 s behind"),
        (172_801.0, "2.00 days (172801.000 s) behind"),
        (1_728_000_000.0, "20000.00 days (1728000000.000 s) behind"),  # since 1970 against since it was switched on
        (-864_000.0, "10.00 days (864000.000 s) ahead of"),
    ],
)
def test_how_far_clocks_are_apart_in_words(offset: float, words: str) -> None:
    exact = Table("/a", TRUE, {}, stamp=TRUE - offset)
    assert reconciled([exact]).notes == (f"stamps of the messages are {words} the recorder's clock; shifted onto it",)


def test_stamps_that_count_and_those_that_do_not() -> None:
    def clock(stamp: np.ndarray, t: np.ndarray = TRUE) -> tuple[str, ...]:
        return reconciled([Table("/a", t, {}, stamp=stamp)]).notes

    assert clock(np.where(np.arange(N) % 10 == 0, np.nan, TRUE)) == ()
    assert "most of its stamps are missing" in clock(np.where(np.arange(N) % 9 == 0, np.nan, TRUE))[0]
    back = np.where(np.arange(N) % 25 == 0, TRUE - 1.0, TRUE)
    assert clock(back) == ()
    assert "its stamps do not increase" in clock(np.repeat(TRUE[::5], 5))[0]
    wander = TRUE + np.where(np.arange(N) % 2, 0.0, 2.5)
    assert "do not increase" in clock(wander)[0]
    late = np.where(TRUE > 20.0, 3.0, 0.0)
    assert (
        "wander against the times of recording"
        in clock(TRUE, TRUE + np.where((TRUE > 10.0) & (TRUE < 30.0), 3.0, 0.0))[0]
    )
    assert clock(TRUE, TRUE + late)
    few = Table("/a", TRUE[:7], {}, stamp=TRUE[:7] + 9.0)
    assert reconciled([few]).tables[0] is few
    assert reconciled([Table("/a", TRUE[:8], {}, stamp=TRUE[:8] + 9.0)]).notes != ()
