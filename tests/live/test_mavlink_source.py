"""A MAVLink link over real sockets on loopback: what is asked, what is answered, what comes, and what breaks."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import time
from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from towtank.errors import InputError
from towtank.live import Raw, Sample, open_source
from towtank.live.links.mavlink.connection import connection_of
from towtank.live.links.mavlink.frames import Frame
from towtank.live.links.mavlink.requests import SYSTEM, Requests, parameter_of
from towtank.live.links.mavlink.source import MavlinkSource
from towtank.readers.mavlink.format import layouts
from towtank.readers.mavlink.senders import Sender
from towtank.vehicle import load_vehicle

from .mavlink_peer import AIDED, Autopilot, free_port

ALLOWED = {"HEARTBEAT", "COMMAND_LONG", "PARAM_REQUEST_READ"}
SET_INTERVAL = 511
LOOKED_INTO = (
    *("HEARTBEAT", "ATTITUDE", "SERVO_OUTPUT_RAW", "LOCAL_POSITION_NED", "COMMAND_ACK", "PARAM_VALUE", "RAW_IMU"),
    *("EKF_STATUS_REPORT", "VISION_POSITION_DELTA", "ODOMETRY", "SCALED_PRESSURE2", "BATTERY_STATUS", "GPS_RAW_INT"),
)


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.live.links.mavlink.source._FIRST", 0.3)
    monkeypatch.setattr("towtank.live.links.mavlink.source._SETTLED", 0.5)
    monkeypatch.setattr("towtank.live.links.mavlink.source._STATE", 0.1)


def source_of(text: str) -> MavlinkSource:
    source = open_source(text, load_vehicle("bluerov2_heavy"))
    assert isinstance(source, MavlinkSource)
    return source


def simulated() -> Autopilot:
    autopilot = Autopilot()
    autopilot.parameters = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 9)}
    return autopilot


class Wire:
    """Sends what an autopilot says, and answers, between two reads of the source."""

    def __init__(self, autopilot: Autopilot, link: Any, to: tuple[str, int] | None) -> None:
        self.autopilot, self.link, self.to = autopilot, link, to
        self.began = time.time()
        self.beaten = 0.0
        self.turns = 0
        link.setblocking(False)

    @property
    def rate(self) -> float:
        """Messages of a kind a second so far, which on a busy machine are fewer."""
        return self.turns / (time.time() - self.began)

    def turn(self) -> None:
        self.turns += 1
        t = time.time() - self.began
        messages = [self.autopilot.attitude(t, 0.1 * t, 0.1), self.autopilot.outputs(t, [1600] * 8)]
        if t >= self.beaten:
            messages += [self.autopilot.heartbeat(), self.autopilot.filter_status(AIDED)]
            self.beaten = t + 0.2
        with contextlib.suppress(BlockingIOError):
            while True:
                data, address = self.link.recvfrom(4096)
                self.to = address or self.to
                messages += self.autopilot.answers(data)
        for message in messages:
            if self.to is None:
                with contextlib.suppress(OSError):
                    self.link.send(message)
            else:
                self.link.sendto(message, self.to)


def run(source: MavlinkSource, wire: Wire, seconds: float) -> list[Sample | Raw]:
    found: list[Sample | Raw] = []
    end = time.time() + seconds
    while time.time() < end:
        wire.turn()
        time.sleep(0.01)
        found += source.read(0.01)
    return found


def first_sample(source: MavlinkSource, wire: Wire) -> Sample | None:
    """Return the first sample that comes within ten seconds."""
    for _ in range(100):
        if samples := [each for each in run(source, wire, 0.1) if isinstance(each, Sample)]:
            return samples[0]
    return None


@pytest.fixture
def udp() -> Iterator[tuple[MavlinkSource, Wire]]:
    port = free_port()
    source = source_of(f"udpin:127.0.0.1:{port}")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        source.open()
        yield source, Wire(simulated(), link, ("127.0.0.1", port))
        source.close()


def kinds(autopilot: Autopilot) -> set[str]:
    return {message.get_type() for message in autopilot.got}


def test_rates_are_asked_for_and_told_and_nothing_else_is_said(udp: tuple[MavlinkSource, Wire]) -> None:
    source, wire = udp
    wire.autopilot.refuses = (dialect.MAVLINK_MSG_ID_RAW_IMU,)
    found = run(source, wire, 1.6)
    for _ in range(100):  # commands wait until parameters were asked for, on a busy machine for longer
        if any(isinstance(each, Sample) and each.topic == "SERVO_OUTPUT_RAW" for each in found):
            break
        found += run(source, wire, 0.1)
    assert kinds(wire.autopilot) == {"COMMAND_LONG", "PARAM_REQUEST_READ"}
    assert {message.command for message in wire.autopilot.got if message.get_type() == "COMMAND_LONG"} == {SET_INTERVAL}
    assert {message.get_srcSystem() for message in wire.autopilot.got} == {SYSTEM}
    assert wire.autopilot.intervals[dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW] == 20_000
    state = source.state()
    assert state.asked["SERVO_OUTPUT_RAW"] == 50.0
    assert state.rates["ATTITUDE"] == pytest.approx(wire.rate, rel=0.5)
    assert any("6 granted; not known: RAW_IMU" in line for line in state.said)
    assert state.senders == ("1.1",)
    samples = [each for each in found if isinstance(each, Sample)]
    assert {sample.topic for sample in samples} == {"ATTITUDE", "HEARTBEAT", "SERVO_OUTPUT_RAW"}
    outputs = [sample for sample in samples if sample.topic == "SERVO_OUTPUT_RAW"]
    assert {each.names for each in outputs} == {tuple(f"cmd_{n}" for n in range(1, 9))}
    assert {each.values for each in outputs} == {(1600.0,) * 8}
    assert all(wire.began - 1e-3 < each.t < each.received + 1e-3 for each in outputs)  # on the clock of this machine


def test_the_bytes_come_first_and_whole(udp: tuple[MavlinkSource, Wire]) -> None:
    source, wire = udp
    sent = [wire.autopilot.attitude(0.1), wire.autopilot.heartbeat() + wire.autopilot.attitude(0.2), b"\xfdnonsense"]
    for data in sent:
        wire.link.sendto(data, wire.to or ("", 0))
    found = [each for _ in range(3) for each in source.read(0.1)]
    assert [each.data for each in found if isinstance(each, Raw)] == sent


def test_to_listen_is_to_say_nothing() -> None:
    port = free_port()
    source = source_of(f"mavlink:udpin:127.0.0.1:{port}?listen")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        source.open()
        wire = Wire(simulated(), link, ("127.0.0.1", port))
        found = run(source, wire, 0.8)
        source.close()
    assert wire.autopilot.got == []
    assert any("no SERVOn_FUNCTION" in line for line in source.state().said)
    assert any(isinstance(each, Sample) and "cmd_8" in each.names for each in found)


def test_who_speaks_first_sends_heartbeats_of_a_ground_station() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        source = source_of(f"udpout:127.0.0.1:{link.getsockname()[1]}")
        source.open()
        source.read(0.01)
        link.settimeout(2.0)
        data, address = link.recvfrom(1000)
        wire = Wire(simulated(), link, address)
        wire.autopilot.answers(data)
        (beat,) = wire.autopilot.got
        assert (beat.get_type(), beat.type, beat.autopilot) == ("HEARTBEAT", 6, 8)
        assert any(isinstance(each, Sample) for each in run(source, wire, 0.8))
        assert kinds(wire.autopilot) <= ALLOWED
        source.close()


def test_tcp_that_breaks_is_connected_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.live.links.mavlink.connection._AGAIN", 0.5)  # s: told even by a machine that stalls
    with socket.create_server(("127.0.0.1", 0)) as server:
        source = source_of(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        source.open()
        link, _ = server.accept()
        with link:
            wire = Wire(simulated(), link, None)
            assert first_sample(source, wire) is not None
            run(source, wire, 0.7)
        server.settimeout(0.02)
        told, again = False, None
        for _ in range(100):
            source.read(0.02)
            told = told or any("trying again" in line for line in source.state().said)
            with contextlib.suppress(TimeoutError):
                again, _ = server.accept()
                break
        assert told
        assert again is not None
        with again:
            assert first_sample(source, Wire(simulated(), again, None)) is not None
        assert not any("trying again" in line for line in source.state().said)
        source.close()


class Line:
    """The other end of a serial line, with the methods of a socket."""

    def __init__(self, handle: int) -> None:
        self._handle = handle
        os.set_blocking(handle, False)

    def setblocking(self, flag: bool) -> None:
        pass

    def recvfrom(self, size: int) -> tuple[bytes, None]:
        return os.read(self._handle, size), None

    def send(self, data: bytes) -> None:
        os.write(self._handle, data)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="takes a pseudo-terminal")
def test_a_serial_line() -> None:
    pytest.importorskip("serial")
    ours, theirs = os.openpty()
    source = source_of(f"{os.ttyname(theirs)},57600")
    source.open()
    wire = Wire(simulated(), Line(ours), None)
    pushed = False
    for _ in range(100):  # a clock settles after a second and a half, later where the machine is slow
        found = run(source, wire, 0.3)
        pushed = pushed or any(isinstance(each, Sample) and "cmd_8" in each.names for each in found)
        if pushed and kinds(wire.autopilot) == {"COMMAND_LONG", "PARAM_REQUEST_READ"}:
            break
    source.close()
    os.close(ours)
    os.close(theirs)
    assert pushed
    assert kinds(wire.autopilot) == {"COMMAND_LONG", "PARAM_REQUEST_READ"}


def test_a_line_that_is_not_there_is_one_line() -> None:
    pytest.importorskip("serial")
    with pytest.raises(InputError, match="cannot be opened"):
        source_of("/dev/towtank-has-no-such-line,57600").open()


def test_malformed_datagrams_are_counted_and_never_raise(udp: tuple[MavlinkSource, Wire]) -> None:
    source, wire = udp
    run(source, wire, 0.5)
    rng = random.Random(7)
    good = [wire.autopilot.attitude(1.0), wire.autopilot.outputs(1.0, [1500] * 8), wire.autopilot.heartbeat()]
    for k in range(1000):
        data = bytearray(rng.choice(good))
        data[rng.randrange(1, len(data))] ^= 1 << rng.randrange(8)
        wire.link.sendto(
            (bytes(data), rng.randbytes(rng.randrange(300)), data[: rng.randrange(20)])[k % 3], wire.to or ("", 0)
        )
        if k % 50 == 0:
            source.read(0.0)
    found = run(source, wire, 0.4)
    assert source.state().bad > 500
    assert any(isinstance(each, Sample) for each in found)


def test_valid_messages_with_any_content_never_raise(udp: tuple[MavlinkSource, Wire]) -> None:
    """Right checksums over random payloads, of every message that the source looks into."""
    source, wire = udp
    run(source, wire, 0.4)
    rng = random.Random(8)
    by_name = {kind.msgname: kind for kind in dialect.mavlink_map.values()}
    for k in range(600):
        kind = by_name[LOOKED_INTO[k % len(LOOKED_INTO)]]
        size = layouts()[kind.id].dtype.itemsize
        wire.link.sendto(_framed(kind, rng.randbytes(rng.randrange(1, size + 1)), k), wire.to or ("", 0))
        if k % 20 == 0:
            source.read(0.0)
    time.sleep(0.5)  # until it is told
    source.read(0.05)
    state = source.state()
    passed_over = [int(text.split()[0]) for text in state.said if "stamps cannot be" in text]
    assert state.bad == sum(passed_over)  # no message was taken to be damaged
    wire.autopilot.boot = 1.0  # what the garbage said of the clock gives way
    assert any(isinstance(each, Sample) for each in run(source, wire, 1.2))


def _framed(kind: Any, payload: bytes, k: int) -> bytes:
    from pymavlink.generator.mavcrc import x25crc

    head = bytes((len(payload), 0, 0, k % 256, 1, 1)) + kind.id.to_bytes(3, "little")
    crc = x25crc(head + payload + bytes((kind.crc_extra,))).crc
    return b"\xfd" + head + payload + crc.to_bytes(2, "little")


@pytest.mark.parametrize(
    "text, expected",
    [
        ("udpin:127.0.0.1", "expected udpin:HOST:PORT"),
        ("udpin:127.0.0.1:0", "port 0"),
        ("udpout::14550", "no host"),
        ("tcp:127.0.0.1:99999", "port 99999"),
        ("udpbcast:1.2.3.4:5", "expected udpin:HOST:PORT"),
        ("/dev/ttyACM0,fast", 'baud rate "fast"'),
    ],
)
def test_what_is_no_link_is_one_line(text: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected) as error:
        source_of(text)
    assert "\n" not in str(error.value)


def test_a_port_that_is_taken_is_one_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        source = source_of(f"udpin:127.0.0.1:{link.getsockname()[1]}")
        with pytest.raises(InputError, match="cannot listen there"):
            source.open()


def test_a_server_that_is_not_there_is_one_line() -> None:
    with pytest.raises(InputError, match="cannot connect"):
        source_of(f"tcp:127.0.0.1:{free_port(socket.SOCK_STREAM)}").open()


def test_two_vehicles_of_one_number_are_not_mixed(udp: tuple[MavlinkSource, Wire]) -> None:
    source, wire = udp
    other = Autopilot(boot=9000.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:

        def rival(seconds: float) -> list[Sample | Raw]:
            found: list[Sample | Raw] = []
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                link.sendto(other.attitude(time.monotonic(), 3.0), wire.to or ("", 0))
                found += run(source, wire, 0.02)
            return found

        run(source, wire, 1.0)
        found = rival(1.0)
    angles = [dict(zip(each.names, each.values, strict=True)).get("psi") for each in found if isinstance(each, Sample)]
    known = [psi for psi in angles if psi is not None]
    assert known
    assert min(abs(psi - 3.0) for psi in known) > 1e-6
    time.sleep(0.5)
    source.read(0.0)
    state = source.state()
    assert state.foreign > 10
    assert any("another vehicle bears a number that is taken (1.1 at 127.0.0.1:" in text for text in state.said)
    assert state.restarts == 0


def test_a_slow_line_is_not_flooded() -> None:
    line = connection_of("/dev/ttyUSB0,57600")
    asked = Requests(speaks_first=False, bandwidth=line.bandwidth).asked
    assert 48.0 * sum(asked.values()) < 0.6 * line.bandwidth
    assert asked["SERVO_OUTPUT_RAW"] > 10.0


def test_questions_without_answer_come_to_an_end() -> None:
    requests = Requests(speaks_first=False)
    requests.aim(Sender(1, 1), 2)
    sent = [data for k in range(1000) for data in requests.due(0.1 * k, 0.1 * k)]
    assert len(sent) < 4 * 60
    assert requests.settled
    assert "no answer" in requests.said()[0]
    assert requests.due(200.0, 200.0) == []


def test_answers_of_others_are_not_taken() -> None:
    requests = Requests(speaks_first=False)
    requests.aim(Sender(1, 1), 2)
    requests.due(0.0, 0.0)
    requests.hear(Frame(77, Sender(2, 1), b"", 2), 511.0, 0.0)
    assert "0 granted" in requests.said()[0]
    requests.hear(Frame(77, Sender(1, 1), b"", 2), 511.0, 0.0)
    assert "1 granted" in requests.said()[0]


def test_whole_numbers_sent_as_their_bits() -> None:
    assert parameter_of("SERVO1_FUNCTION", 33 * 2.0**-149, 6) == 33.0
    assert parameter_of("SERVO1_FUNCTION", 33.0, 6) == 33.0
    assert parameter_of("BARO1_GND_PRESS", 101_325.0, 9) == 101_325.0


def decoded(sent: list[bytes]) -> list[Any]:
    return [message for data in sent for message in dialect.MAVLink(None).parse_buffer(data)]


def test_questions_are_put_one_rate_at_a_time_and_again_after_a_second() -> None:
    requests = Requests(speaks_first=False)
    assert requests.due(0.0, 0.0) == []
    requests.aim(Sender(3, 4), 2)

    def rates(now: float) -> list[Any]:
        return [each for each in decoded(requests.due(now, now)) if each.get_type() == "COMMAND_LONG"]

    (first,) = rates(10.0)
    assert (first.get_srcSystem(), first.get_srcComponent()) == (SYSTEM, 190)
    assert (first.target_system, first.target_component, first.command) == (3, 4, SET_INTERVAL)
    assert (int(first.param1), first.param2) == (dialect.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW, 20_000.0)
    assert rates(10.9) == []
    (again,) = rates(11.0)
    assert again.param1 == first.param1
    requests.hear(Frame(77, Sender(3, 4), b"", 2), 511.0, 5.0)  # in progress: no answer yet
    requests.hear(Frame(77, Sender(3, 4), b"", 2), 400.0, 0.0)  # to another question
    assert rates(11.5) == []
    requests.hear(Frame(77, Sender(3, 4), b"", 2), 511.0, 0.0)
    (second,) = rates(11.5)
    assert int(second.param1) == dialect.MAVLINK_MSG_ID_ATTITUDE


def test_parameters_are_asked_for_eight_at_once_once_the_rates_are_settled() -> None:
    requests = Requests(speaks_first=False)
    requests.aim(Sender(1, 1), 2)
    for _ in range(7):
        requests.due(0.0, 0.0)
        requests.hear(Frame(77, Sender(1, 1), b"", 2), 511.0, 0.0)
    asked = [decoded(requests.due(1.0 + 0.01 * k, 1.0)) for k in range(6)]
    names = [message.param_id for each in asked for message in each]
    assert [len(each) for each in asked][:4] == [8, 8, 8, 8]
    assert sum(len(each) for each in asked) == len(set(names)) == 16 + 12 + 5 + 3 + 2
    assert {"SERVO1_FUNCTION", "SERVO16_FUNCTION", "MOT_1_DIRECTION", "MOT_12_DIRECTION", "VISO_POS_Z"} <= set(names)
    assert not requests.settled
    assert all(requests.learn(name, 1.0) for name in names)
    assert not requests.learn("VISO_POS_Z", 1.0)
    assert requests.learn("VISO_POS_Z", 2.0)
    assert requests.settled
    assert requests.due(5.0, 5.0) == []
    assert requests.parameters["VISO_POS_Z"] == 2.0


def test_messages_are_numbered_from_0_to_255_and_round() -> None:
    requests = Requests(speaks_first=True)
    numbers = [message.get_seq() for k in range(300) for message in decoded(requests.due(float(k), float(k)))]
    assert numbers == [k % 256 for k in range(300)]


def test_a_heartbeat_goes_out_once_a_second_where_nothing_comes_for_three() -> None:
    requests = Requests(speaks_first=False)
    assert [t for t in (1.0, 3.0, 3.5, 4.0, 4.5, 5.0) if requests.due(t, 0.0)] == [3.5, 4.5]
    (beat,) = decoded(requests.due(9.0, 0.0))
    assert (beat.type, beat.autopilot, beat.system_status) == (6, 8, 4)
    assert Requests(speaks_first=False, silent=True).due(9.0, 0.0) == []
    assert Requests(speaks_first=False, silent=True).settled


def test_what_was_asked_and_answered_is_said_by_answer() -> None:
    requests = Requests(speaks_first=False)
    assert requests.said() == []
    requests.aim(Sender(1, 1), 1)
    for answer in (0.0, 1.0, 2.0, 3.0, 4.0, 9.0):
        data = requests.due(0.0, 0.0)
        assert data[0][0] == 0xFE  # version 1 of MAVLink, as the autopilot speaks
        requests.hear(Frame(77, Sender(1, 1), b"", 2), 511.0, answer)
    assert requests.said() == [
        "asked 1.1 for the rates of 7 messages, 1 granted; refused for now: ATTITUDE; "
        "refused: LOCAL_POSITION_NED, EKF_STATUS_REPORT; not known: RAW_IMU; failed: SCALED_PRESSURE2"
    ]
    assert Requests(speaks_first=False, silent=True).said() == ["asks for nothing, as told"]


def test_an_autopilot_that_starts_anew_is_asked_again_and_another_one_has_parameters_of_its_own() -> None:
    requests = Requests(speaks_first=False)
    requests.also({"VFR_HUD": 4.0}, ["PILOT_GAIN"])
    requests.aim(Sender(1, 1), 2)
    requests.learn("SERVO1_FUNCTION", 33.0)
    for _ in range(8):
        requests.due(0.0, 0.0)
        requests.hear(Frame(77, Sender(1, 1), b"", 2), 511.0, 0.0)
    assert requests.said() == ["asked 1.1 for the rates of 8 messages, 8 granted"]
    assert decoded(requests.due(0.0, 0.0))[0].param_id == "PILOT_GAIN"
    requests.aim(Sender(1, 1), 2)
    assert "8 granted" in requests.said()[0]
    requests.begin_anew()
    assert "0 granted" in requests.said()[0]
    assert requests.parameters == {"SERVO1_FUNCTION": 33.0}
    requests.aim(Sender(2, 1), 2)
    assert requests.parameters == {}


@pytest.mark.parametrize("bandwidth, slowest, fastest", [(0.0, 2.0, 50.0), (100.0, 2.0, 2.0), (1e6, 2.0, 50.0)])
def test_a_line_tells_how_often_may_be_asked(bandwidth: float, slowest: float, fastest: float) -> None:
    asked = Requests(speaks_first=False, bandwidth=bandwidth).asked
    assert (min(asked.values()), max(asked.values())) == (slowest, fastest)


@pytest.mark.parametrize(
    "value, kind, meant",
    [(2.0**-149, 6.0, 1.0), (-(2.0**-149), 6.0, -(2.0**31) + 1), (2.0**-149, 9.0, 2.0**-149), (0.0, 6.0, 0.0)],
)
def test_tiny_numbers_are_bits_where_a_whole_number_is_meant(value: float, kind: float, meant: float) -> None:
    assert parameter_of("X", value, kind) == meant


def test_a_vehicle_with_another_address_is_named_and_what_it_sends_passed_over() -> None:
    """Fed by hand: the source hears frames of two addresses that bear one number."""
    source = source_of(f"udpin:127.0.0.1:{free_port()}")
    layout = layouts()
    (number,) = [number for number, each in layout.items() if each.name == "HEARTBEAT"]
    frame = Frame(number, Sender(1, 1), bytes(9), 2)
    home, others = ("127.0.0.1", 1), [("127.0.0.1", 2 + k) for k in range(300)]
    assert source._hear(frame, 0.0, home)
    assert not any(source._hear(frame, 0.1, each) for each in others)
    assert source._hear(frame, 0.2, home)
    assert len(source._foreign) <= 257
    assert sum(source._foreign.values()) == 300
    assert source._hear(frame, 60.0, others[0])  # who was heard first has fallen silent
    assert not source._hear(frame, 60.1, home)


def test_the_autopilots_parameters_and_address_are_known_to_who_drives() -> None:
    source = source_of(f"udpin:127.0.0.1:{free_port()}")
    assert source.target is None
    assert source.parameters == {}
    source._requests.aim(Sender(1, 1), 2)
    source._requests.learn("SERVO1_FUNCTION", 33.0)
    assert source.target == Sender(1, 1)
    assert source.parameters == {"SERVO1_FUNCTION": 33.0}
    listening = source_of(f"mavlink:udpin:127.0.0.1:{free_port()}?listen")
    with pytest.raises(InputError, match="with which nothing may be sent; leave it out"):
        listening.also({"VFR_HUD": 4.0}, [])


@pytest.mark.parametrize(
    "text, kind, host, port",
    [
        ("udp:127.0.0.1:14550", "UdpIn", "127.0.0.1", 14550),
        ("UDPIN://:1", "UdpIn", "0.0.0.0", 1),
        ("udpin:[::1]:65535", "UdpIn", "::1", 65535),
        ("udpout:localhost:14550", "UdpOut", "localhost", 14550),
        ("tcp:sub.local:5760", "Tcp", "sub.local", 5760),
    ],
)
def test_a_link_is_known_by_its_words(text: str, kind: str, host: str, port: int) -> None:
    found: Any = connection_of(text)
    assert type(found).__name__ == kind
    assert (found._host, found._port) == (host, port) if kind == "Tcp" else (found.host, found.port) == (host, port)
    assert (found.stream, found.speaks_first) == (kind == "Tcp", kind == "UdpOut")
    assert (found.bandwidth, found.broken, found.dropped) == (0.0, "", 0)


@pytest.mark.parametrize(
    "text, device, baud",
    [
        ("/dev/ttyACM0", "/dev/ttyACM0", 115200),
        ("serial:///dev/ttyUSB1:57600", "/dev/ttyUSB1", 57600),
        ("COM3,9600", "COM3", 9600),
    ],
)
def test_a_line_is_known_by_its_words(text: str, device: str, baud: int) -> None:
    line: Any = connection_of(text)
    assert (line._device, line._baud, line.bandwidth) == (device, baud, baud / 10.0)
    assert (line.stream, line.speaks_first) == (True, False)


def test_a_host_that_is_not_known_is_one_line() -> None:
    for host in ("no.such.host.invalid", "x" * 70):
        with pytest.raises(InputError, match="is not known") as error:
            connection_of(f"udpout:{host}:14550").open()
        assert "\n" not in str(error.value)


def test_what_breaks_is_said_and_tried_again_after_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        now = 100.0
        monkeypatch.setattr("towtank.live.links.mavlink.connection.time.monotonic", lambda: now)
        monkeypatch.setattr("towtank.live.links.mavlink.connection.time.sleep", lambda seconds: None)
        link = connection_of(f"tcp:127.0.0.1:{server.getsockname()[1]}")
        link.open()
        peer, _ = server.accept()
        peer.send(b"first")
        assert [each[0] for each in link.receive(1.0)] == [b"first"]
        assert link.receive(0.0) == []
        assert link.broken == ""
        peer.close()
        assert link.receive(1.0) == []
        assert link.broken.endswith("the other end has closed; trying again")
        now = 100.9
        assert link.receive(0.0) == []
        assert link.broken
        now = 101.0
        link.receive(0.0)
        assert link.broken == ""
        peer, _ = server.accept()
        peer.send(b"again")
        assert [each[0] for each in link.receive(1.0)] == [b"again"]
        link.close()
        peer.close()


def test_a_link_on_which_nothing_comes_says_for_how_long(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [1000.0]
    monkeypatch.setattr("towtank.live.links.mavlink.source.steady_time", lambda: clock[0])
    text = f"udpin:127.0.0.1:{free_port()}"
    source = source_of(text)
    source.open()
    said = f"{text}: nothing has come for 3 s"
    for now, told in ((1001.9, False), (1003.2, True)):
        clock[0] = now
        source.read(0.0)
        assert (said in source.state().said) is told
    source.close()
