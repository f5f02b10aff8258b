"""Records of a ROS 1 bag byte by byte: chunks that cannot be unpacked, messages that belong to nothing, ends."""

from __future__ import annotations

import bz2
import struct
from pathlib import Path

import lz4.frame
import pytest

from towtank.errors import InputError
from towtank.readers.common.raw_messages import Topic
from towtank.readers.ros.bag1 import scan_rosbag1
from towtank.recording.repairs import Repairs

MAGIC = b"#ROSBAG V2.0\n"


def fields(**values: bytes) -> bytes:
    out = b""
    for name, value in values.items():
        text = name.encode() + b"=" + value
        out += struct.pack("<I", len(text)) + text
    return out


def record(op: int, body: bytes = b"", **header: bytes) -> bytes:
    head = fields(op=bytes([op]), **header)
    return struct.pack("<I", len(head)) + head + struct.pack("<I", len(body)) + body


def connection(number: int, topic: str, kind: str = "std_msgs/Float64") -> bytes:
    about = fields(topic=topic.encode(), type=kind.encode(), md5sum=b"x", message_definition=b"float64 data\n")
    return record(7, about, conn=struct.pack("<I", number), topic=topic.encode())


def message(number: int, seconds: int, nanoseconds: int, data: bytes) -> bytes:
    return record(2, data, conn=struct.pack("<I", number), time=struct.pack("<II", seconds, nanoseconds))


def chunk(records: bytes, compression: str = "none", packed: bytes | None = None) -> bytes:
    packed = records if packed is None else packed
    return record(5, packed, compression=compression.encode(), size=struct.pack("<I", len(records)))


def scanned(folder: Path, *records: bytes) -> tuple[dict[str, Topic], Repairs]:
    (folder / "a.bag").write_bytes(MAGIC + b"".join(records))
    topics, repairs = scan_rosbag1(folder / "a.bag", lambda topic, kind: True)
    return {topic.name: topic for topic in topics}, repairs


DATA = connection(3, "/a") + message(3, 1, 5, b"first") + message(3, 2, 0, b"second")
LISTED = record(6)


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_messages_of_a_chunk_have_their_times_and_topics(tmp_path: Path, compression: str) -> None:
    packed = {"none": bytes, "bz2": bz2.compress, "lz4": lz4.frame.compress}[compression](DATA)
    found, repairs = scanned(tmp_path, chunk(DATA, compression, packed), connection(3, "/a"), LISTED)
    assert found["/a"].log_time.tolist() == [1_000_000_005, 2_000_000_000]
    assert found["/a"].raw is not None
    assert found["/a"].raw.messages() == [b"first", b"second"]
    assert found["/a"].kind == "std_msgs/msg/Float64"
    assert found["/a"].definition == ("float64 data\n", "ros1msg")
    assert not repairs


def test_names_are_put_right_and_two_publishers_are_one_topic(tmp_path: Path) -> None:
    one = connection(1, "//a/b/") + connection(2, "/a/b") + connection(4, "c")
    sent = message(1, 2, 0, b"x") + message(2, 1, 0, b"y") + message(4, 1, 0, b"z")
    found, repairs = scanned(tmp_path, chunk(one + sent), LISTED)
    assert sorted(found) == ["/a/b", "c"]
    assert found["/a/b"].log_time.tolist() == [1_000_000_000, 2_000_000_000]
    assert (repairs.disorder, repairs.damaged) == (1, 0)


def test_what_is_damaged_is_counted_one_by_one_and_the_rest_is_read(tmp_path: Path) -> None:
    lost = message(9, 1, 0, b"of no connection") + record(2, b"", conn=b"\3\0\0\0") + record(2, b"", time=b"\0" * 7)
    found, repairs = scanned(tmp_path, chunk(DATA + lost), LISTED)
    assert len(found["/a"]) == 2
    assert repairs.damaged == 3
    cut, repairs = scanned(tmp_path, chunk(DATA + message(3, 3, 0, b"third")[:-1]), LISTED)
    assert (len(cut["/a"]), repairs.damaged) == (2, 1)
    _, repairs = scanned(tmp_path, record(7, b"\1\0\0\0", conn=b"\1\0\0\0", topic=b"/x"), chunk(DATA), LISTED)
    assert repairs.damaged == 1


@pytest.mark.parametrize("compression", ["bz2", "lz4", "br"])
def test_a_chunk_that_cannot_be_unpacked_is_named_by_its_place(tmp_path: Path, compression: str) -> None:
    bad = chunk(DATA, compression, b"nonsense" * 20)
    found, repairs = scanned(tmp_path, *[bad] * 8, chunk(DATA), LISTED, *[LISTED] * 8)
    why = 'its compression "br" is not known' if compression == "br" else "it cannot be unpacked"
    assert repairs.damaged == 8
    places = [len(MAGIC) + k * len(bad) for k in range(6)]
    assert repairs.details == tuple(f"chunk at byte {at} left out: {why}" for at in places)
    assert len(found["/a"]) == 2


def test_a_chunk_may_unpack_to_64_mib_or_a_thousandfold(tmp_path: Path) -> None:
    for size, why in (((1 << 26) + 1, "it says that it unpacks to 67108865 bytes"), (1 << 26, "cannot be unpacked")):
        huge = record(5, b"x", compression=b"bz2", size=struct.pack("<I", size))
        _, repairs = scanned(tmp_path, huge, LISTED)
        assert any(why in line for line in repairs.details)


def test_a_bag_without_an_end_says_so(tmp_path: Path) -> None:
    no_end = "the bag has no end: its recording was interrupted, or it was cut"
    for records, said in (
        ((chunk(DATA),), True),
        ((chunk(DATA), LISTED), False),
        ((chunk(DATA), chunk(DATA), LISTED), True),
    ):
        assert (no_end in scanned(tmp_path, *records)[1].details) is said
    assert no_end in scanned(tmp_path)[1].details


def test_bytes_between_chunks_are_counted_and_the_next_chunk_is_found(tmp_path: Path) -> None:
    later = connection(3, "/a") + message(3, 9, 0, b"later")
    found, repairs = scanned(tmp_path, chunk(DATA), b"\xff" * 1000, chunk(later), LISTED, LISTED)
    assert found["/a"].log_time.tolist()[-1] == 9_000_000_000
    assert repairs.details == ("1000 bytes that make no record (left out)",)
    whole = chunk(DATA)
    found, repairs = scanned(tmp_path, whole[:-1])  # cut by the end of the file
    assert (len(found["/a"]), repairs.damaged) == (1, 1)


def test_another_version_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V1.2\nmore")
    with pytest.raises(InputError, match=r"found '#ROSBAG V1\.2', expected a ROS bag of version 2\.0"):
        scan_rosbag1(tmp_path / "a.bag", lambda topic, kind: True)


def test_messages_that_are_not_wanted_are_counted_and_not_kept(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(MAGIC + chunk(DATA) + LISTED)
    [topic], _ = scan_rosbag1(tmp_path / "a.bag", lambda topic, kind: False)
    assert (len(topic), topic.raw) == (2, None)
