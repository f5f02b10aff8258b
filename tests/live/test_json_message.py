"""What a line of JSON means, and what is wrong with it."""

from __future__ import annotations

import json
import math
import socket
import sys
from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.live import Raw, Sample
from towtank.live.links.datagrams import Allowance, Datagrams
from towtank.live.links.json import JsonMessages, JsonSource
from towtank.recording import Column, ColumnMapping, Marker, Recording, marker_to_origin, to_ned_frd
from towtank.recording.channel import standard_channel
from towtank.vehicle import load_vehicle

from .mavlink_peer import free_port

THRUSTERS = ("port", "stbd")


def decoded(message: object, **settings: object) -> tuple[JsonMessages, float, dict[str, float]]:
    messages = JsonMessages(THRUSTERS, ColumnMapping(**settings) if settings else None)  # type: ignore[arg-type]
    found = messages.decode(json.dumps(message).encode())
    assert found is not None
    return messages, found[0], dict(zip(found[1], found[2], strict=True))


def test_names_are_those_of_recordings() -> None:
    messages, t, found = decoded({"t": 12.5, "x": 1, "psi": -0.5, "q": None, "voltage": 15.2, "cmd": [1500, 1620]})
    assert t == 12.5
    assert found == {"x": 1.0, "psi": -0.5, "voltage": 15.2, "cmd_port": 1500.0, "cmd_stbd": 1620.0}
    assert messages.bad == 0


def test_commands_may_be_named_and_the_time_left_out() -> None:
    messages, t, found = decoded({"cmd": {"stbd": 3.0}, "cmd_port": 4, "battery": 9, "note": {"a": [1]}})
    assert math.isnan(t)
    assert found == {"cmd_stbd": 3.0, "cmd_port": 4.0}
    assert messages.unknown == {"battery": 1, "note": 1}


@pytest.mark.parametrize("body", ["FRD", "FLU"])
@pytest.mark.parametrize("world", ["NED", "ENU"])
def test_frames_are_converted_as_in_files(body: str, world: str) -> None:
    sample = {
        **dict(zip(("x", "y", "z", "phi", "theta", "psi"), (1.0, 2.0, 3.0, 0.1, -0.2, 0.3), strict=True)),
        **dict(zip(("u", "v", "w", "p", "q", "r"), (0.4, 0.5, 0.6, 0.7, 0.8, 0.9), strict=True)),
        **dict(zip(("ax", "ay", "az", "vn", "ve", "vd"), (1.1, 1.2, 1.3, 1.4, 1.5, 1.6), strict=True)),
        **dict(zip(("X", "Y", "Z", "K", "M", "N"), (2.1, 2.2, 2.3, 2.4, 2.5, 2.6), strict=True)),
    }
    file = Recording({name: standard_channel(name, [0.0], [value]) for name, value in sample.items()})
    expected = {name: channel.values[0] for name, channel in to_ned_frd(file, body=body, world=world).channels.items()}
    _, _, told = decoded({**sample, "frame": {"body": body, "world": world}})
    _, _, mapped = decoded(sample, body=body, world=world, columns={name: Column(source=name) for name in sample})
    assert told == pytest.approx(expected)
    assert mapped == pytest.approx(expected)


def test_a_quaternion_is_turned_and_a_zero_one_left_out() -> None:
    half = math.sqrt(0.5)
    _, _, found = decoded({"qw": half, "qx": 0, "qy": 0, "qz": half, "frame": {"body": "FLU", "world": "ENU"}})
    assert abs(found["qw"]) == pytest.approx(1.0)  # facing north
    messages = JsonMessages(THRUSTERS)
    assert messages.decode(b'{"qw": 0, "qx": 0, "qy": 0, "qz": 0}') is None


def test_a_mapping_reaches_into_the_message() -> None:
    _, t, found = decoded(
        {"stamp": 1500, "pose": {"position": [1.0, 2.0]}, "heading_deg": 90.0, "pwm": [1500, 1600]},
        thrusters=["pwm[0]", "pwm[1]"],
        columns={
            "t": Column(source="stamp", scale=1e-3),
            "x": "pose.position[0]",
            "psi": Column(source="heading_deg", scale=math.pi / 180.0),
            "z": "pose.depth",
        },
    )
    assert t == pytest.approx(1.5)
    assert found == pytest.approx({"x": 1.0, "psi": math.pi / 2.0, "cmd_1": 1500.0, "cmd_2": 1600.0})


def test_a_marker_is_moved_to_the_origin_as_in_files() -> None:
    sample = {"x": 1.0, "y": 2.0, "z": 3.0, "phi": 0.1, "theta": -0.2, "psi": 0.3}
    sample |= {"u": 0.4, "v": 0.5, "w": 0.6, "p": 0.7, "q": 0.8, "r": 0.9}
    arm = (0.1, -0.2, 0.3)
    t = [0.0, 0.1]
    file = marker_to_origin(
        Recording({name: standard_channel(name, t, [value, value]) for name, value in sample.items()}), arm
    )
    columns = {name: Column(source=name) for name in sample}
    _, _, found = decoded(sample, columns=columns, marker=Marker(position=arm))
    assert found == pytest.approx({name: file[name].values[0] for name in sample})


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"x",
        b"[1]",
        b"3",
        b'{"t": 1e999, "x": 1}',
        b'{"t": "noon", "x": 1}',
        b'{"x": true}',
        b'{"x": 1e300}',
        b'{"x": 1' + b"0" * 500 + b"}",
        b'{"cmd": [1, 2, 3]}',
        b'{"cmd": 7}',
        b"[" * 50_000,
        b'{"a":' * 50_000,
        b"\xff\xfe",
        b'{"frame": {"body": []}}',
    ],
)
def test_what_cannot_be_used_is_counted(line: bytes) -> None:
    messages = JsonMessages(THRUSTERS)
    assert messages.decode(line) is None
    assert messages.bad == 1
    assert messages.wrong.isascii()


def test_keys_that_mean_nothing_do_not_fill_the_memory() -> None:
    messages = JsonMessages(THRUSTERS)
    for k in range(1000):
        messages.decode(json.dumps({f"key\x1b{k}": 1}).encode())
    assert len(messages.unknown) == 101
    assert sum(messages.unknown.values()) == 1000
    assert all(key.isprintable() for key in messages.unknown)


def test_not_a_number_is_not_measured() -> None:
    messages = JsonMessages(THRUSTERS)
    assert messages.decode(b'{"x": NaN, "y": 1}') == (pytest.approx(np.nan, nan_ok=True), ("y",), (1.0,))


def test_of_two_senders_of_one_channel_the_first_is_followed() -> None:
    port = free_port()
    source = JsonSource(f"json:127.0.0.1:{port}", load_vehicle("seamor"))
    source.open()
    found: list[Sample | Raw] = []
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pose,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        for k in range(20):
            pose.sendto(json.dumps({"x": float(k), "y": 0.0}).encode(), ("127.0.0.1", port))
            found += source.read(0.5)
            other.sendto(json.dumps({"x": 99.0, "voltage": 15.0}).encode(), ("127.0.0.1", port))
            found += source.read(0.5)
    source.close()
    samples = [each for each in found if isinstance(each, Sample)]
    pairs = [pair for each in samples for pair in zip(each.names, each.values, strict=True)]
    assert [value for name, value in pairs if name == "x"] == [float(k) for k in range(20)]
    assert [value for name, value in pairs if name == "voltage"] == [15.0] * 20  # which nobody else tells
    assert source.state().foreign == 20
    assert any("sends channels that come from another sender already: 20" in text for text in source.state().said)
    assert len(found) - len(samples) == 40  # all of it is recorded as it came


def test_noise_is_recorded_up_to_a_bound_and_counted_beyond() -> None:
    allowance = Allowance()
    taken = sum(allowance.takes(bytes(1000)) for _ in range(5000))
    assert 1000 <= taken <= 1500
    assert allowance.passed_over == 5000 - taken
    assert "not recorded" in allowance.said[0]


def test_a_sender_that_falls_silent_gives_its_channels_up() -> None:
    source = JsonSource("json:127.0.0.1:9", load_vehicle("vlbv300"))
    one, other, both = ("1.1.1.1", 1), ("2.2.2.2", 2), (0.0, ("x", "y"), (1.0, 2.0))
    assert source._own(both, 10.0, one) == both
    assert source._own((0.0, ("y", "z"), (3.0, 4.0)), 11.0, other) == (0.0, ("z",), (4.0,))
    assert (source._foreign, source._rival) == (1, "2.2.2.2:2")
    assert source._own(both, 11.01, other) == both
    assert source._own(both, 12.0, one) == (0.0, (), ())
    assert source._foreign == 3


def test_of_what_is_bad_a_part_is_kept_and_of_what_is_good_all() -> None:
    source = JsonSource("json:127.0.0.1:9", load_vehicle("vlbv300"))
    out: list[Raw | Sample] = []
    good = b'{"x": 1' + b" " * 6000 + b"}"
    source._take(good, 0.0, out)
    source._take(b"x" * 6000, 0.0, out)
    source._take(b"", 0.0, out)
    assert [len(each.data) for each in out if isinstance(each, Raw)] == [len(good), 4096]
    assert [each.names for each in out if isinstance(each, Sample)] == [("x",)]


@pytest.mark.parametrize(
    "text", ["json:", "json:host", "json:host:", "json:host:x", "json:host:0", "json:host:65536", "json:host:²"]
)
def test_a_port_is_a_number_that_can_be_one(text: str) -> None:
    with pytest.raises(InputError, match="with a port of 1 to 65535"):
        JsonSource(text, load_vehicle("vlbv300"))
    for port in (1, 65535):
        assert JsonSource(f"json:[::1]:{port}", load_vehicle("vlbv300"))._address == ("::1", port)


def test_a_peer_that_does_not_listen_yet_is_heard_once_it_does() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind(("127.0.0.1", 0))
        there = ("127.0.0.1", free_port())
        own.connect(there)
        link = Datagrams(own)
        own.send(b"anybody?")
        assert link.receive(0.2) == []
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.bind(there)
            peer.sendto(b"here", own.getsockname())
            assert [data for data, _, _ in link.receive(0.5)] == [b"here"]


def test_standard_input_is_read_no_more_once_it_is_closed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "said.json"
    path.write_text('{"t": 0.0, "x": 1.0}\n')
    with path.open() as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        source = JsonSource("-", load_vehicle("vlbv300"))
        source.open()
        found = [each for each in source.read(0.1) if isinstance(each, Sample)]
        source.close()
        assert [each.values for each in found] == [(1.0,)]
        assert source.read(0.0) == []
        assert not source.state().ended  # it was left, not read to its end
