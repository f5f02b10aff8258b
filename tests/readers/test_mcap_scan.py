"""An MCAP file record by record: what is read once, what belongs to nothing, and what is said to be missing."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest

from towtank.errors import InputError
from towtank.readers.common.raw_messages import Topic
from towtank.readers.mcap.scan import McapContent, scan_mcap
from towtank.recording.mcap.format import MAGIC

from .test_mcap_records import index, message, record


def text(words: str) -> bytes:
    data = words.encode()
    return struct.pack("<I", len(data)) + data


def channel(number: int, topic: str, schema: int = 0, encoding: str = "json") -> bytes:
    return record(4, struct.pack("<HH", number, schema) + text(topic) + text(encoding) + struct.pack("<I", 0))


def schema(number: int, name: str) -> bytes:
    return record(3, struct.pack("<H", number) + text(name) + text("jsonschema") + text("{}"))


def chunk(records: bytes, *, checksum: int | None = None) -> bytes:
    head = struct.pack("<QQQI", 0, 0, len(records), zlib.crc32(records) if checksum is None else checksum)
    return record(6, head + text("") + struct.pack("<Q", len(records)) + records)


HEADER, FOOTER = record(1, text("") + text("")), record(2, bytes(20))
END = record(15, bytes(4)) + FOOTER + MAGIC


def statistics(messages: int) -> bytes:
    return record(11, struct.pack("<QHIIIIQQ", messages, 0, 0, 0, 0, 0, 0, 0) + struct.pack("<I", 0))


def metadata(name: str, **values: str) -> bytes:
    pairs = b"".join(text(key) + text(value) for key, value in values.items())
    return record(12, text(name) + struct.pack("<I", len(pairs)) + pairs)


def scanned(folder: Path, *records: bytes, wanted: bool = True) -> tuple[dict[str, Topic], McapContent]:
    (folder / "a.mcap").write_bytes(MAGIC + HEADER + b"".join(records))
    content = scan_mcap(folder / "a.mcap", lambda heading: wanted)
    return {topic.name: topic for topic in content.topics}, content


def messages(topic: Topic) -> list[bytes]:
    assert topic.raw is not None
    return topic.raw.messages()


FIRST = channel(1, "/a", 7) + message(1, 10, b"one") + message(1, 20, b"three")


@pytest.mark.parametrize("indices", [b"", record(7, index(1, [(10, 37)])[:-4])])
def test_a_chunk_is_walked_where_its_index_does_not_help(tmp_path: Path, indices: bytes) -> None:
    found, content = scanned(tmp_path, schema(7, "own.Kind"), chunk(FIRST), indices, END)
    assert messages(found["/a"]) == [b"one", b"three"]
    assert found["/a"].log_time.tolist() == [10, 20]
    assert (found["/a"].kind, found["/a"].encoding, found["/a"].definition) == (
        "own.Kind",
        "json",
        ("{}", "jsonschema"),
    )
    assert not content.repairs


def test_what_an_index_leaves_out_is_walked(tmp_path: Path) -> None:
    start = len(channel(1, "/a", 7))
    partly = record(7, index(1, [(20, start + len(message(1, 10, b"one")))]))
    found, content = scanned(tmp_path, chunk(FIRST), partly, END)
    assert messages(found["/a"]) == [b"one", b"three"]
    assert not content.repairs


def test_a_chunk_that_stands_twice_is_read_once(tmp_path: Path) -> None:
    places = record(7, index(1, [(10, len(channel(1, "/a", 7))), (20, 40)]))
    found, content = scanned(tmp_path, chunk(FIRST), places, chunk(FIRST), places, END)
    assert messages(found["/a"]) == [b"one", b"three"]
    assert content.repairs.details == ("2 messages stand twice in the file (read once)",)
    assert content.repairs.damaged == 0
    unchecked = chunk(FIRST, checksum=0)
    found, _ = scanned(tmp_path, unchecked, unchecked, END)
    assert len(found["/a"]) == 4


def test_messages_outside_of_chunks_and_of_no_channel(tmp_path: Path) -> None:
    loose = message(1, 30, b"loose") + message(9, 40, b"of none") + message(1, 5, b"early")
    found, content = scanned(tmp_path, channel(1, "/a"), loose, END)
    assert messages(found["/a"]) == [b"early", b"loose"]
    assert content.repairs.disorder == 1
    assert content.repairs.damaged == 1
    assert content.repairs.details == ("1 messages of channels that the file does not describe",)


def test_messages_that_are_not_wanted_have_times_alone(tmp_path: Path) -> None:
    found, _ = scanned(tmp_path, chunk(FIRST), END, wanted=False)
    assert (found["/a"].raw, found["/a"].log_time.tolist()) == (None, [10, 20])


def test_what_statistics_promise_and_is_not_there_is_counted(tmp_path: Path) -> None:
    _, content = scanned(tmp_path, chunk(FIRST), statistics(5), END)
    assert content.repairs.damaged == 3
    _, content = scanned(tmp_path, chunk(FIRST), statistics(2), END)
    assert not content.repairs
    _, content = scanned(tmp_path, chunk(FIRST), statistics(1), END)
    assert not content.repairs
    bad = chunk(FIRST, checksum=5)
    _, content = scanned(tmp_path, bad, record(7, index(1, [(10, 37), (20, 71)])), statistics(2), END)
    assert content.repairs.damaged == 2
    assert "its checksum is wrong" in content.repairs.details[0]


def test_files_one_behind_the_other_have_channels_of_their_own(tmp_path: Path) -> None:
    second = MAGIC + HEADER + channel(1, "/b") + message(1, 7, b"two") + statistics(1) + END
    found, content = scanned(tmp_path, chunk(FIRST), statistics(2), END, second)
    assert (messages(found["/a"]), messages(found["/b"])) == ([b"one", b"three"], [b"two"])
    assert not content.repairs


def test_a_file_without_an_end_says_so(tmp_path: Path) -> None:
    said = "the file has no end: its recording was interrupted, or it was cut"
    assert scanned(tmp_path, chunk(FIRST))[1].repairs.details == (said,)
    assert scanned(tmp_path, chunk(FIRST), END)[1].repairs.details == ()
    details = scanned(tmp_path, chunk(FIRST), b"\xff" * 77, chunk(channel(1, "/a") + message(1, 40, b"x")), END)[
        1
    ].repairs.details
    assert details == ("77 bytes that make no record (left out)",)


def test_records_that_are_damaged_within_are_counted(tmp_path: Path) -> None:
    broken = record(4, struct.pack("<HH", 5, 0) + b"\xff\0\0\0" + bytes(12))
    found, content = scanned(tmp_path, broken, chunk(FIRST + broken), END)
    assert (len(found["/a"]), content.repairs.damaged) == (2, 2)
    torn = chunk(FIRST + message(1, 50, b"torn")[:-1])
    found, content = scanned(tmp_path, torn, END)
    assert (len(found["/a"]), content.repairs.damaged) == (2, 1)


def test_the_last_metadata_of_a_name_counts(tmp_path: Path) -> None:
    _, content = scanned(tmp_path, metadata("about", a="1"), metadata("other", b="2"), metadata("about", a="3"), END)
    assert content.metadata == {"about": {"a": "3"}, "other": {"b": "2"}}


def test_what_is_no_mcap_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP1\r\nmore")
    with pytest.raises(InputError, match="expected the first bytes of MCAP version 0"):
        scan_mcap(tmp_path / "a.mcap", lambda heading: True)


def test_records_of_other_kinds_within_a_chunk_are_no_messages(tmp_path: Path) -> None:
    found, content = scanned(tmp_path, chunk(FIRST + metadata("about", words="more than twenty-two bytes")), END)
    assert messages(found["/a"]) == [b"one", b"three"]
    assert content.repairs.details == ()
