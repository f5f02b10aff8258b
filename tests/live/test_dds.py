"""ROS 2 over DDS without ROS: messages of a writer that tells its type, and of topics that are none of ROS."""

from __future__ import annotations

import time

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.live import Raw, Sample, open_source
from towtank.live.links.ros2.transports import DdsLink, _struct
from towtank.vehicle import load_vehicle

from .ros2_peer import ODOMETRY, WRENCH, odometry, wrench

pytest.importorskip("cyclonedds")

DOMAIN = 91
LOOPBACK = """<CycloneDDS><Domain Id="any"><General><AllowMulticast>false</AllowMulticast>
<Interfaces><NetworkInterface name="lo"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


class Publisher:
    """Writes messages that are bytes already, as ROS does: the type of its topic is told apart from them."""

    def __init__(self, topic: str, kind: str) -> None:
        from cyclonedds.core import Policy, Qos
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.pub import DataWriter
        from cyclonedds.topic import Topic

        self._participant = DomainParticipant(DOMAIN)
        message = _struct.__wrapped__(kind)
        qos = Qos(Policy.Reliability.Reliable(0), Policy.History.KeepLast(1000))
        self._writer = DataWriter(self._participant, Topic(self._participant, topic, message), qos=qos)
        self._message = message

    def write(self, data: bytes) -> None:
        made = self._message.__new__(self._message)
        made.serialize = lambda *rest, **more: data
        self._writer.write(made)


@pytest.fixture
def loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)


def test_odometry_and_wrench_over_dds(loopback: None) -> None:
    source = open_source(f"dds:{DOMAIN}", load_vehicle("bluerov2_heavy"))
    pose, force = Publisher("rt/odom", ODOMETRY), Publisher("rt/thrust", WRENCH)
    other = Publisher("rq/odom", ODOMETRY)
    source.open()
    found: list[Sample | Raw] = []
    end = time.monotonic() + 20.0
    began = time.time()
    heard: set[str] = set()
    while time.monotonic() < end and len(heard) < 2:
        stamp = time.time()
        t = stamp - began  # readings that never change are no measurements
        pose.write(odometry(stamp, (t, 2.0 - t, 3.0 + t), 0.3 + t, (0.4 + t, 0.05 + t, t, 0.01 + t, t, 0.3 - t)))
        force.write(wrench(stamp, (10.0, 2.0, 3.0, 0.1, 0.2, 0.5)))
        other.write(odometry(stamp, (9.0, 9.0, 9.0), 0.3, (9.0,) * 6))
        found += source.read(0.02)
        heard = {each.topic for each in found if isinstance(each, Sample)}
    state = source.state()
    source.close()
    source.close()
    samples = [each for each in found if isinstance(each, Sample)]
    assert state.bad == 0
    assert set(state.senders) == {"/odom", "/thrust"}
    assert {each.topic for each in samples} == {"/odom", "/thrust"}
    first = next(each for each in samples if each.topic == "/odom")
    t, known = first.t - began, dict(zip(first.names, first.values, strict=True))
    for name, value in {"x": t, "y": 2.0 - t, "z": 3.0 + t, "u": 0.4 + t, "v": 0.05 + t, "r": 0.3 - t}.items():
        np.testing.assert_allclose(known[name], value, atol=0.02)  # s by which the stamp moves to our clock
    push = next(each for each in samples if each.topic == "/thrust")
    assert dict(zip(push.names, push.values, strict=True)) == {
        "X": 10.0,
        "Y": 2.0,
        "Z": 3.0,
        "K": 0.1,
        "M": 0.2,
        "N": 0.5,
    }
    assert all(began <= each.t <= time.time() for each in samples)
    raw = {each.topic for each in found if isinstance(each, Raw)}
    assert raw == {f"/odom {ODOMETRY}", f"/thrust {WRENCH}"}


def test_every_type_that_means_something_can_be_told_to_dds() -> None:
    from towtank.readers.ros.meaning import MEANINGS

    for kind in MEANINGS:
        made = _struct(kind)
        made.__idl__.fill_type_data()
        package, _, name = kind.partition("/msg/")
        assert made.__idl_typename__.replace(".", "::") == f"{package}::msg::dds_::{name}_"


def test_a_type_that_is_not_known_is_said(loopback: None) -> None:
    link = DdsLink(f"dds:{DOMAIN}")
    link.open()
    assert "is not known" in link.subscribe("/mine", "my_msgs/msg/Mine")
    link.close()


def test_wrong_domain_missing_library_and_broken_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="expected dds:"):
        DdsLink("dds:mine")
    with pytest.raises(InputError, match="0 to 232"):
        DdsLink("dds:233")
    with monkeypatch.context() as patch:
        patch.setattr("importlib.util.find_spec", lambda name: None)
        with pytest.raises(InputError, match=r"towtank\[dds\]"):
            DdsLink("dds:1")
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Domain><Nothing/></Domain></CycloneDDS>")
    with pytest.raises(InputError, match="DDS does not start"):
        DdsLink("dds:92").open()
