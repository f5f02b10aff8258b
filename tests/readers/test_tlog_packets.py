"""Packets of a telemetry log one by one: found, checked, counted, and what lies between them."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from towtank.readers.mavlink.format import layouts
from towtank.readers.mavlink.tlog import Packets, scan_tlog

T = 1_700_000_000_000_000  # us
LAYOUTS = layouts()
NUMBER, SIZE = 0, 9  # of HEARTBEAT


def beat(k: int, *, version: int = 2, system: int = 1, signed: bool = False) -> bytes:
    link = mavlink.MAVLink(None, srcSystem=system, srcComponent=4)
    if signed:
        link.signing.secret_key, link.signing.sign_outgoing, link.signing.timestamp = bytes(32), True, 1
    message = mavlink.MAVLink_heartbeat_message(12, 3, 81, 1000 + k, 4, 3)
    return (T + k).to_bytes(8, "big") + bytes(message.pack(link, force_mavlink1=version == 1))


def found(*parts: bytes) -> Packets:
    return scan_tlog(b"".join(parts), LAYOUTS)


def modes(packets: Packets, system: int = 1) -> list[int]:
    payloads = packets.groups[NUMBER, system, 4].payloads
    return [int(row["custom_mode"]) for row in LAYOUTS[NUMBER].rows(payloads)]


@pytest.mark.parametrize("version, signed", [(1, False), (2, False), (2, True)])
def test_packets_have_places_stamps_and_contents(version: int, signed: bool) -> None:
    parts = [beat(k, version=version, signed=signed) for k in range(5)]
    packets = found(*parts)
    group = packets.groups[NUMBER, 1, 4]
    assert list(group.stamps) == [T + k for k in range(5)]
    assert list(group.places) == [k * len(parts[0]) for k in range(5)]
    assert modes(packets) == [1000, 1001, 1002, 1003, 1004]
    assert (packets.stretches, packets.skipped, packets.wrong.total(), packets.unknown.total()) == (0, 0, 0, 0)


def test_senders_are_told_apart() -> None:
    packets = found(beat(0), beat(1, system=2), beat(2))
    assert (modes(packets), modes(packets, 2)) == ([1000, 1002], [1001])


@pytest.mark.parametrize("version", [1, 2])
def test_a_wrong_checksum_is_one_wrong_packet(version: int) -> None:
    for at in (-1, -2, -5):
        bad = bytearray(beat(1, version=version))
        bad[at] ^= 0x10
        packets = found(beat(0, version=version), bytes(bad), beat(2, version=version))
        assert packets.wrong == {(NUMBER, 1, 4): 1}
        assert modes(packets) == [1000, 1002]
        assert (packets.stretches, packets.skipped) == (0, 0)


@pytest.mark.parametrize("rubbish", [b"x", b"\xfd", b"\xfe\x09", b"\xfd" * 30, bytes(5000)])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_bytes_between_packets_are_one_stretch(rubbish: bytes, place: int) -> None:
    parts = [beat(0), beat(1)]
    parts.insert(place, rubbish)
    packets = found(*parts)
    assert modes(packets) == [1000, 1001]
    assert (packets.stretches, packets.skipped) == (1, len(rubbish))
    assert not packets.given_up


def test_what_the_end_cuts_off_is_a_stretch() -> None:
    whole = beat(1)
    for cut in (1, 8, 9, 12, len(whole) - 1):
        packets = found(beat(0), whole[:cut])
        assert modes(packets) == [1000]
        assert (packets.stretches, packets.skipped) == (1, cut)


def test_messages_of_unknown_numbers_are_counted_where_packets_follow() -> None:
    strange = T.to_bytes(8, "big") + b"\xfd\x03\0\0\x05\x01\x01\xff\xff\x07abc\x12\x34"
    packets = found(beat(0), strange, strange, beat(1))
    assert packets.unknown == {0x07FFFF: 2}
    assert (packets.stretches, packets.skipped) == (0, 0)
    last = found(beat(0), strange)
    assert last.unknown.total() == 0
    assert (last.stretches, last.skipped) == (1, len(strange))


def test_a_search_in_vain_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.readers.mavlink.tlog._MANY_VAIN", 5)
    monkeypatch.setattr("towtank.readers.mavlink.tlog._MOST_VAIN", 10)
    vain = b"\xfe" + bytes(30)
    assert not found(beat(0), vain * 9, beat(1)).given_up
    stamped = T.to_bytes(8, "big") + vain
    packets = found(beat(0), stamped * 40, beat(1))
    assert packets.given_up
    assert modes(packets) == [1000]
    assert packets.skipped == 40 * len(stamped) + len(beat(1))
