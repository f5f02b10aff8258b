"""Sources of a ROS recording that are no measurement, and stamps, each by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.readers.common.raw_messages import Topic
from towtank.readers.common.sources import Source
from towtank.readers.common.tables import Table
from towtank.readers.ros.doubts import judged
from towtank.readers.ros.tables import _named, _seconds, _stamp, epoch_of, origin_of

T = np.arange(40) / 10.0
WAVE = np.sin(T)


def source(quantity: str, table: str = "/a", **channels: Array) -> Source:
    return Source(table, quantity, T, channels)  # type: ignore[arg-type]


def refusal(one: Source, *names: str, kind: str = "", **columns: Array) -> str:
    tables = {name: Table(name, T, columns, kind) for name in (one.table, *names)}
    return judged([one], tables)[0].refused


def test_a_field_that_never_changes_is_filled_in() -> None:
    still = np.full(40, 2.0)
    assert refusal(source("rates", p=still, q=np.full(40, np.nan), r=still)).startswith("it never changes")
    assert refusal(source("rates", p=still, q=still, r=WAVE)) == ""
    assert refusal(source("voltage", voltage=still)) == ""
    few = replace(source("rates", p=still[:3]), t=T[:3])
    assert judged([few], {"/a": Table("/a", T[:3], {})})[0].refused == ""
    assert refusal(replace(source("rates", p=still), refused="said before")) == "said before"


@pytest.mark.parametrize("aid", ["/dvl/data", "/mavros/vision_pose/pose", "/MOCAP/rigid", "/usbl"])
def test_an_autopilots_velocity_counts_where_something_aids_it(aid: str) -> None:
    own = source("velocity", "/mavros/local_position/velocity_body", u=WAVE)
    assert "nothing in the recording aids its velocity" in refusal(own)
    assert refusal(own, aid) == ""
    assert refusal(source("attitude", "/mavros/local_position/pose", phi=WAVE)) == ""
    assert refusal(source("velocity", "/own/velocity", u=WAVE)) == ""


@pytest.mark.parametrize("std, unsure", [(0.49, False), (0.51, True)])
def test_a_velocity_says_itself_how_sure_it_is(std: float, unsure: bool) -> None:
    variance = np.append(np.full(39, std**2), np.nan)
    found = refusal(source("velocity", u=WAVE), **{"twist.covariance[0]": variance})
    assert found == ("its own covariance says ± 0.51 m/s: nothing aids it" if unsure else "")


def test_a_depth_above_the_highest_lakes_is_of_no_absolute_pressure() -> None:
    def depth(z: float, note: str) -> Source:
        return replace(source("depth", z=z + 0.1 * WAVE), note=note)

    assert 'z = { from = "/a.fluid_pressure"' in refusal(depth(-6.2, "from pressure"))
    assert refusal(depth(-5.8, "from pressure")) == ""
    assert refusal(depth(-6.2, "")) == ""


def test_outputs_that_move_are_numbered_in_order() -> None:
    still, none = np.full(40, 1500.0), np.full(40, np.nan)
    outputs = source("commands", cmd_1=still, cmd_3=1500.0 + WAVE, cmd_7=1500.0 - WAVE, cmd_8=none)
    tables = {"/a": Table("/a", T, {}, "mavros_msgs/msg/RCOut")}
    [found] = judged([outputs], tables)
    assert list(found.channels) == ["cmd_1", "cmd_2"]
    assert found.channels["cmd_2"].tolist() == (1500.0 - WAVE).tolist()
    assert "outputs 3, 7, which move, are taken as thrusters in their order" in found.note
    [rests] = judged([source("commands", cmd_1=still)], tables)
    assert rests.refused == "no output moves"
    for kind in ("std_msgs/msg/Float64MultiArray", "a/msg/First", "zzz/msg/Last"):
        [same] = judged([outputs], {"/a": Table("/a", T, {}, kind)})
        assert list(same.channels) == ["cmd_1", "cmd_3", "cmd_7", "cmd_8"]


def test_an_imu_whose_gravity_points_up_is_refused_whole() -> None:
    def judge(az: float) -> list[str]:
        force = source("specific force", ax=WAVE, ay=WAVE, az=az + 0.1 * WAVE)
        some = [force, source("rates", p=WAVE, q=WAVE, r=WAVE), source("velocity", u=WAVE)]
        return [each.refused.partition(":")[0] for each in judged(some, {"/a": Table("/a", T, {})})]

    assert judge(9.8) == ["gravity points up in it", "gravity points up in it", ""]
    assert judge(5.2)[0] == "gravity points up in it"
    assert judge(4.8) == judge(-9.8) == ["", "", ""]


@pytest.mark.parametrize(
    ("origin", "epoch"),
    [
        (10**17 - 1, {}),
        (10**17, {"epoch": "1973-03-03T09:46:40+00:00"}),
        (1_700_000_000_123_456_789, {"epoch": "2023-11-14T22:13:20.123456+00:00"}),
        (0, {}),
        (10**21, {}),
    ],
)
def test_a_log_that_counts_from_1970_tells_its_day(origin: int, epoch: dict[str, str]) -> None:
    assert epoch_of(origin) == epoch


def test_stamps_count_from_the_logs_first_message_and_zero_is_none() -> None:
    origin = 1_700_000_000_250_000_000
    seconds, nanoseconds = np.array([1.7e9, 0.0, 0.0, 1.7e9 + 2.0]), np.array([5e8, 0.0, 7e8, 0.0])
    columns = {"header.stamp.sec": seconds, "header.stamp.nanosec": nanoseconds}
    found = _stamp(columns, origin)
    assert found is not None
    np.testing.assert_allclose(found, [0.25, np.nan, 0.45 - 1.7e9, 1.75])
    assert _stamp({name: 0.0 * values for name, values in columns.items()}, origin) is None
    assert _stamp({"header.stamp.sec": columns["header.stamp.sec"]}, origin) is None
    assert _seconds(np.array([origin, origin + 1_500_000_000]), origin).tolist() == [0.0, 1.5]


def test_the_first_message_of_all_is_the_origin_and_a_topic_of_two_types_two_tables() -> None:
    def topic(*times: int) -> Topic:
        return Topic("/a", "k", "cdr", np.array(times, dtype=np.int64), None)

    assert origin_of([topic(), topic(5, 6), topic(3)]) == 3
    assert origin_of([topic()]) == 0
    tables = [Table("/a", T, {}, "one"), Table("/b", T, {}, "one"), Table("/a", T, {"x": T}, "two")]
    named = _named(tables)
    assert list(named) == ["/a", "/b", "/a[two]"]
    assert named["/a[two]"].kind == "two"
