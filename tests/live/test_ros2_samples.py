"""ROS 2 as it comes: frames, header stamps, choice among topics, mappings, broken messages; rclpy and zenoh alike."""

from __future__ import annotations

import math
import random
import time

import numpy as np
import pytest
from numpy.typing import NDArray

from towtank.errors import InputError
from towtank.live import Raw, Sample
from towtank.live.links.ros2.samples import Ros2Samples
from towtank.live.links.ros2.source import Ros2Source
from towtank.live.links.ros2.transports import Message, domain_of, link_of, topic_of_key, topic_of_token
from towtank.recording.mapping import ColumnMapping

from .mavlink_peer import free_port
from .ros2_peer import ODOMETRY, STATE, TWIST, WRENCH, odometry, state, twist, wrench

EPOCH, APART = 1_700_000_000.0, 5 * 86_400.0  # the publishers' clock is five days behind


def second(start: float, topic: str = "/odom", late: float = 0.003) -> list[Message]:
    """Return a second of a vehicle that surges and turns."""
    found = []
    for k in range(50):
        t = start + k / 50
        place, rates = (1.0 + 0.4 * t, 2.0, 3.0), (0.4, 0.05, -0.02, 0.01, 0.02, 0.3)
        pose = odometry(EPOCH - APART + t, place, 0.3 * t, rates)
        force = wrench(EPOCH - APART + t, (10.0 + k, 2.0, 3.0, 0.1, 0.2, 0.5))
        found += [
            Message(topic, ODOMETRY, EPOCH + t + late, pose),
            Message("/thrust", WRENCH, EPOCH + t + late, force),
        ]
    return found


def channel(samples: list[Sample], name: str) -> NDArray[np.float64]:
    pairs = (pair for sample in samples for pair in zip(sample.names, sample.values, strict=True))
    return np.array([value for key, value in pairs if key == name])


def heard(samples: Ros2Samples, messages: list[Message], at_once: int = 3) -> list[Sample]:
    found: list[Sample] = []
    for k in range(0, len(messages), at_once):
        found += samples.take(messages[k : k + at_once])
    return found


def test_odometry_and_wrench_in_standard_frames() -> None:
    samples = Ros2Samples(None)
    assert heard(samples, second(0.0) + second(1.0)) == []
    samples.decide(EPOCH + 2.0)
    found = heard(samples, second(2.0))
    t = 2.0 + np.arange(50) / 50
    np.testing.assert_allclose(channel(found, "x"), 1.0 + 0.4 * t, atol=1e-9)
    np.testing.assert_allclose(channel(found, "z"), 3.0)
    np.testing.assert_allclose(channel(found, "u"), 0.4)
    np.testing.assert_allclose(channel(found, "v"), 0.05)
    np.testing.assert_allclose(channel(found, "r"), 0.3)
    np.testing.assert_allclose(channel(found, "X"), 10.0 + np.arange(50))
    np.testing.assert_allclose(channel(found, "N"), 0.5)
    heading = 2.0 * np.arctan2(channel(found, "qz"), channel(found, "qw"))
    np.testing.assert_allclose(np.cos(heading - 0.3 * t), 1.0, atol=1e-9)


def test_the_state_of_mavros_is_armed_and_a_mode_with_its_name() -> None:
    """Modes are numbered as they come once it is decided what is used, and keep their numbers."""

    def said(t: float, mode: str, *, armed: bool) -> Message:
        return Message("/mavros/state", STATE, EPOCH + t, state(EPOCH - APART + t, mode, armed=armed))

    samples = Ros2Samples(None)
    heard(samples, [*second(0.0), *second(1.0), said(1.99, "MANUAL", armed=False)])
    samples.decide(EPOCH + 2.0)
    found = heard(samples, [*second(2.0), said(3.0, "SURFACE", armed=True), said(4.0, "MANUAL", armed=True)])
    told = [dict(zip(each.names, each.values, strict=True)) for each in found if each.topic == "/mavros/state"]
    assert told == [{"armed": 1.0, "mode": 0.0}, {"armed": 1.0, "mode": 1.0}]
    assert samples.attributes == {"modes": "0 SURFACE, 1 MANUAL"}


def test_stamps_are_the_headers_on_our_clock_and_one_for_all_topics() -> None:
    samples = Ros2Samples(None)
    late_wrench = [
        m._replace(received=m.received + 0.03) if m.topic == "/thrust" else m for m in second(0.0) + second(1.0)
    ]
    heard(samples, late_wrench)
    samples.decide(EPOCH + 2.0)
    found = heard(samples, second(2.0))
    for topic in ("/odom", "/thrust"):
        stamps = [sample.t - EPOCH for sample in found if sample.topic == topic]
        np.testing.assert_allclose(stamps, 2.003 + np.arange(50) / 50, atol=1e-3, rtol=0)


def test_velocity_in_a_world_frame_is_turned() -> None:
    samples = Ros2Samples(None)

    def crowd(start: float) -> list[Message]:
        others = []
        for k in range(250):
            t = start + k / 250
            others.append(Message("/mocap/twist", TWIST, EPOCH + t, twist(EPOCH - APART + t, (0.0, 1.0, 0.0), "map")))
        return sorted(second(start) + others, key=lambda each: each.received)

    heard(samples, crowd(0.0) + crowd(1.0))
    samples.decide(EPOCH + 2.0)
    found = [each for each in heard(samples, crowd(2.0)) if each.topic == "/mocap/twist"]
    psi = 0.3 * np.array([sample.t - EPOCH for sample in found])
    np.testing.assert_allclose(channel(found, "u"), np.cos(psi), atol=2e-3)  # north 1 m/s
    np.testing.assert_allclose(channel(found, "v"), -np.sin(psi), atol=2e-3)


def test_a_mapping_names_topics_and_fields() -> None:
    mapping = ColumnMapping.model_validate(
        {"body": "FLU", "columns": {"v": "/odom.twist.twist.linear.y", "X": "/thrust.wrench.force.x"}}
    )
    found = heard(Ros2Samples(mapping), second(0.0))
    np.testing.assert_allclose(channel(found, "v"), 0.05)
    np.testing.assert_allclose(channel(found, "X"), 10.0 + np.arange(50))
    assert {name for sample in found for name in sample.names} == {"v", "X"}


@pytest.mark.parametrize("mapped", [False, True])
def test_broken_messages_never_raise(mapped: bool) -> None:
    rng = random.Random(11)
    mapping = ColumnMapping.model_validate({"columns": {"v": "/odom.twist.twist.linear.y"}}) if mapped else None
    samples = Ros2Samples(mapping)
    heard(samples, second(0.0) + second(1.0))
    samples.decide(EPOCH + 2.0)
    good = second(2.0)
    with np.errstate(all="ignore"):
        for message in good * 3:
            data = bytearray(message.data)
            for _ in range(rng.randrange(1, 4)):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            cut = bytes(data[: rng.randrange(len(data))]) if rng.random() < 0.5 else bytes(data)
            samples.take([message._replace(data=cut), message])
        samples.decide(EPOCH + 3.0)
    assert samples.bad > 20
    assert heard(samples, second(3.0))


def test_keys_and_tokens_of_rmw_zenoh() -> None:
    mangled = "nav_msgs::msg::dds_::Odometry_"
    assert topic_of_key(f"0/rov/odom/{mangled}/RIHS01_ab") == ("/rov/odom", ODOMETRY)
    assert topic_of_key(f"0/odom/{mangled}") == ("/odom", ODOMETRY)
    assert topic_of_key("0/odom") is None
    token = f"@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/talker/%rov%odom/{mangled}/RIHS01_ab/::,7:,:,:,,"
    assert topic_of_token(token) == ("/rov/odom", ODOMETRY)
    assert topic_of_token(token.replace("/MP/", "/MS/")) is None
    assert topic_of_token("@ros2_lv/0/aa/0/10/NN/%/%/talker") is None


def test_zenoh_with_keys_as_rmw_zenoh_makes_them() -> None:
    zenoh = pytest.importorskip("zenoh")
    port = free_port()
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    mangled = {ODOMETRY: "nav_msgs::msg::dds_::Odometry_", WRENCH: "geometry_msgs::msg::dds_::WrenchStamped_"}
    source = Ros2Source(f"ros2:7@tcp/127.0.0.1:{port}")
    with zenoh.open(config) as router:
        tokens = [
            router.liveliness().declare_token(
                f"@ros2_lv/7/ab/0/1/MP/%/%/sim/%{topic}/{mangled[kind]}/RIHS01_cd/::,7:,:,:,,"
            )
            for topic, kind in (("odom", ODOMETRY), ("thrust", WRENCH))
        ]
        source.open()
        found: list[Sample | Raw] = []
        end = time.time() + 3.0
        while time.time() < end:
            t = time.time()
            router.put(
                f"7/odom/{mangled[ODOMETRY]}/RIHS01_cd",
                odometry(t, (math.sin(t), 0, 1), 0.1, (0.4, 0, 0, 0, 0, 0.1 * t % 1)),
            )
            router.put(f"7/thrust/{mangled[WRENCH]}/RIHS01_cd", wrench(t, (1.0, 0, 0, 0, 0, 0.5)))
            found += source.read(0.02)
        assert sorted(source.state().senders) == ["/odom", "/thrust"]  # in the order in which they are found
        source.close()
        del tokens
    assert {each.topic for each in found if isinstance(each, Sample)} == {"/odom", "/thrust"}
    assert any(isinstance(each, Raw) and each.topic == f"/odom {ODOMETRY}" for each in found)


def test_what_is_no_domain_is_one_line() -> None:
    with pytest.raises(InputError, match=r"expected ros2:\[DOMAIN\]"):
        link_of("ros2:mine")


@pytest.mark.parametrize(
    ("told", "environment", "domain"), [(None, "42", 42), (None, "", 0), (None, "mine", 0), (7, "42", 7), (0, "42", 0)]
)
def test_a_domain_that_is_not_told_is_that_of_the_environment(
    monkeypatch: pytest.MonkeyPatch, told: int | None, environment: str, domain: int
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", environment)
    assert domain_of(told) == domain
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert domain_of(told) == (told or 0)


def test_a_topic_that_has_fallen_slow_gives_way_to_one_that_goes_on() -> None:
    samples = Ros2Samples(None)

    def odometries(topic: str, times: NDArray[np.float64]) -> list[Message]:
        told = [(t, odometry(EPOCH + t, (t, 2.0 - t, 3.0 + t), 0.1 * t, (0.4 + t, t, t, t, t, t))) for t in times]
        return [Message(topic, ODOMETRY, EPOCH + t, data) for t, data in told]

    fast, slow = np.arange(0.0, 2.0, 0.01), np.arange(2.0, 16.0, 0.5)
    heard(samples, [*odometries("/first", np.append(fast, slow)), *odometries("/second", np.arange(0.0, 16.0, 0.1))])
    samples.decide(EPOCH + 16.0)
    assert samples.quantities.used["position"] == "/second"


def test_a_router_that_is_not_there_is_one_line() -> None:
    pytest.importorskip("zenoh")
    with pytest.raises(InputError, match=r"no zenoh router at tcp/127\.0\.0\.1") as error:
        Ros2Source(f"ros2:0@tcp/127.0.0.1:{free_port()}").open()
    assert "\n" not in str(error.value)


class Link:
    """A system of topics by hand, on a clock of its own."""

    name = "by hand"

    def __init__(self) -> None:
        self.published: dict[str, str] = {}
        self.refused: dict[str, str] = {}
        self.waiting: list[Message] = []
        self.asked: list[str] = []
        self.looks = self.opened = self.closed = 0

    def open(self) -> None:
        self.opened += 1

    def topics(self) -> dict[str, str]:
        self.looks += 1
        return dict(self.published)

    def subscribe(self, topic: str, kind: str) -> str:
        self.asked.append(topic)
        return self.refused.get(topic, "")

    def receive(self, timeout: float) -> list[Message]:
        found, self.waiting = self.waiting, []
        return found

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def by_hand(monkeypatch: pytest.MonkeyPatch) -> tuple[Link, list[float]]:
    link, clock = Link(), [EPOCH]
    monkeypatch.setattr("towtank.live.links.ros2.source.link_of", lambda text: link)
    monkeypatch.setattr("towtank.live.links.ros2.source.steady_time", lambda: clock[0])
    return link, clock


def test_a_source_that_was_not_opened_has_nothing_to_close(by_hand: tuple[Link, list[float]]) -> None:
    link, _ = by_hand
    source = Ros2Source("ros2:0")
    source.close()
    assert link.closed == 0
    source.open()
    source.close()
    source.close()
    assert (link.opened, link.closed) == (1, 1)
    assert source.state().said == ("by hand", "no topic that could be used is published")


def test_topics_are_looked_for_once_a_second_and_asked_for_once(by_hand: tuple[Link, list[float]]) -> None:
    link, clock = by_hand
    link.published = {"/odom": ODOMETRY, "/chatter": "std_msgs/msg/String", "/bad": WRENCH}
    link.refused = {"/bad": "its type is not known"}
    source = Ros2Source("ros2:0")
    source.open()
    for k in range(21):
        clock[0] = EPOCH + 0.1 * k + 1e-3
        source.read(0.0)
    assert link.looks == 3
    assert link.asked == ["/odom", "/bad"]
    assert source.state().said[:3] == ("by hand", "listens to /odom", "/bad: not listened to: its type is not known")
    assert source.state().senders == ("/odom",)


def test_what_comes_is_recorded_at_once_and_learned_from_after_the_first_decision(
    by_hand: tuple[Link, list[float]],
) -> None:
    link, clock = by_hand
    link.published = {"/odom": ODOMETRY, "/thrust": WRENCH}
    source = Ros2Source("ros2:0")
    source.open()
    first = None
    for k in range(4):
        for message in second(float(k)):
            clock[0] = message.received
            link.waiting = [message]
            found = source.read(0.0)
            assert [each.topic for each in found if isinstance(each, Raw)] == [f"{message.topic} {message.kind}"]
            if first is None and any(isinstance(each, Sample) for each in found):
                first = message.received - EPOCH
    assert first == pytest.approx(1.5, abs=0.05)
    state = source.state()
    assert (state.bad, state.restarts) == (0, 0)
    assert source._rates.counts == {"/odom": 200, "/thrust": 200}


def test_a_mapping_names_what_is_not_published(by_hand: tuple[Link, list[float]]) -> None:
    link, clock = by_hand
    link.published = {"/odom": ODOMETRY, "/thrust": WRENCH}
    mapping = ColumnMapping.model_validate(
        {"columns": {"v": "/odom.twist.twist.linear.y", "u": "/dvl.velocity.x", "w": "/dvl.velocity.z"}}
    )
    source = Ros2Source("ros2:0", mapping)
    source.open()
    clock[0] += 1.0
    source.read(0.0)
    assert source.state().said == (
        "by hand",
        "listens to /odom",
        "the mapping's /dvl.velocity.x is not published",
        "the mapping's /dvl.velocity.z is not published",
    )
