"""What a file is, by its first bytes."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from towtank.readers.recognition import (
    FOLDER,
    HEAD,
    foreign_kind,
    is_dataflash,
    is_dataflash_text,
    is_matlab,
    is_rosbag,
    is_text,
    is_tlog,
)

T = 1_700_000_000_000_000  # us
FORMAT = b"\xa3\x95\x80" + bytes(86)
LINE = b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"


def packets(count: int, version: int = 2, *, signed: bool = False, apart: int = 1000, first: int = T) -> bytes:
    """Heartbeats as a telemetry log has them, some microseconds apart."""
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    if signed:
        link.signing.secret_key, link.signing.sign_outgoing, link.signing.timestamp = bytes(32), True, 1
    out = b""
    for k in range(count):
        message = mavlink.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3)
        out += (first + k * apart).to_bytes(8, "big") + message.pack(link, force_mavlink1=version == 1)
    return out


@pytest.mark.parametrize("version, signed", [(1, False), (2, False), (2, True)])
@pytest.mark.parametrize("before", [b"", b"\xfe\x01rubbish", bytes(4000)])
def test_three_packets_in_a_row_make_a_telemetry_log(version: int, signed: bool, before: bytes) -> None:
    assert is_tlog(before + packets(3, version, signed=signed), ".tlog")
    assert is_tlog(before + packets(8, version, signed=signed), ".tlog")
    assert not is_tlog(before + packets(2, version, signed=signed), ".tlog")


def test_packets_that_begin_late_or_are_cut_make_none() -> None:
    assert not is_tlog(bytes(4096) + packets(9), ".tlog")
    assert not is_tlog(packets(3)[8:], ".tlog")
    assert not is_tlog(packets(2) + packets(1)[:10], ".tlog")
    assert is_tlog(packets(2) + packets(1)[:11], ".tlog")


def test_stamps_are_of_this_century_and_within_an_hour_of_each_other() -> None:
    hour = 3_600_000_000
    assert is_tlog(packets(3, apart=hour - 1), ".tlog")
    assert is_tlog(packets(3, apart=1 - hour), ".tlog")
    assert not is_tlog(packets(3, apart=hour), ".tlog")
    assert is_tlog(packets(3, first=1), ".tlog")
    assert not is_tlog(packets(3, first=0), ".tlog")
    assert is_tlog(packets(3, first=4_102_444_799_999_999), ".tlog")
    assert not is_tlog(packets(3, first=4_102_444_800_000_000), ".tlog")


def test_a_dataflash_log_begins_with_its_mark_or_has_three_formats() -> None:
    assert is_dataflash(b"\xa3\x95\x01", ".BIN")
    assert is_dataflash(b"cut" + 3 * FORMAT, ".BIN")
    assert not is_dataflash(b"cut" + 2 * FORMAT, ".BIN")
    assert is_dataflash(b"broken \xff\n" + LINE, ".log")
    assert is_dataflash_text(LINE)
    assert not is_dataflash_text(LINE + FORMAT)
    assert not is_dataflash_text(b"no " + LINE)


def test_bags_and_matlab_files_are_known_by_their_marks() -> None:
    assert is_rosbag(b"rosbag2_bagfile_information:\n", FOLDER)
    assert not is_rosbag(b"rosbag2_bagfile_information:\n", ".yaml")
    assert not is_rosbag(b"#ROSBAG V2.0\n", FOLDER)
    assert is_rosbag(b"#ROSBAG V2.0\n", ".bag")
    assert is_rosbag(b"SQLite format 3\0", ".db3")
    assert is_matlab(b"MATLAB 7.3 MAT-file", ".mat")
    assert is_matlab(b"MATLAB 5.0 MAT-file", ".mat")
    assert not is_matlab(b"MATLAB 8.0 MAT-file", ".mat")


@pytest.mark.parametrize(
    "head, text",
    [
        ("t,Größe\n".encode(), True),
        (b"t,u\0\n", False),
        (b"t,u\n\xff\n" + bytes(range(1, 100)), False),
        ("Größe".encode()[:-3] + b"\xc3", False),
        (b"a" * (HEAD - 1) + b"\xc3", True),  # a character cut where the head ends
        (b"a" * (HEAD - 3) + b"\xf0\x9f\x98", True),
        (b"a" * (HEAD - 4) + b"\xc3aaa", False),
    ],
)
def test_text_is_utf_8_without_zeros(head: bytes, text: bool) -> None:
    assert is_text(head) is text


def test_what_no_reader_takes_is_named() -> None:
    assert foreign_kind(b"PK\x03\x04...") == "a zip archive or a spreadsheet; unpack it or save it as CSV"
    assert foreign_kind(b"\x1f\x8b\x08") == "gzip; unpack it first"
    assert foreign_kind(b"t,u\n") is None
