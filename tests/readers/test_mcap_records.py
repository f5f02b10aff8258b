"""Records of an MCAP file, field by field and byte by byte."""

from __future__ import annotations

import mmap
import struct
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

import lz4.frame
import numpy as np
import pytest
import zstandard

from towtank.readers.mcap.records import CHUNK, MESSAGE, Chunk, Fields, count, gaps, indexed, records_of, signed
from towtank.recording.mcap.format import MAGIC


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def message(channel: int, time: int, data: bytes) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", channel, 0, time, time) + data)


def index(channel: int, entries: list[tuple[int, int]]) -> bytes:
    return struct.pack("<HI", channel, 16 * len(entries)) + b"".join(struct.pack("<QQ", *each) for each in entries)


def chunk(records: bytes, *, compression: str = "", packed: bytes | None = None, checksum: int = 0) -> bytes:
    name, packed = compression.encode(), records if packed is None else packed
    head = struct.pack("<QQQI", 3, 9, len(records), checksum) + struct.pack("<I", len(name)) + name
    return head + struct.pack("<Q", len(packed)) + packed


@contextmanager
def mapped(data: bytes) -> Iterator[mmap.mmap]:
    with tempfile.TemporaryFile() as file:
        file.write(data)
        file.flush()
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as view:
            yield view


def read(data: bytes) -> list[tuple[int, int, bytes, int, bool]]:
    with mapped(data) as view:
        return [tuple(each) for each in records_of(view)]


DATA = b"".join((message(1, 10, b"abc"), message(2, 20, b""), message(1, 30, b"defgh")))
PLACES = [0, 34, 65]


def test_the_index_tells_where_messages_lie_in_order_of_their_place() -> None:
    buffer = np.frombuffer(DATA, dtype=np.uint8)
    found = indexed(buffer, [index(1, [(30, 65), (10, 0)]), index(2, [(20, 34)])])
    assert found.start.tolist() == [31, 65, 96]
    assert found.size.tolist() == [3, 0, 5]
    assert found.channel.tolist() == [1, 2, 1]
    assert found.log_time.tolist() == [10, 20, 30]
    assert count([index(1, [(30, 65), (10, 0)]), index(2, [(20, 34)]), b"short"]) == 3
    assert count([index(1, [])]) == 0


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        [index(1, [])],
        [index(1, [(10, 0)])[:-1]],
        [b"\1\0"],
        [index(1, [(10, 1)])],  # no record begins there
        [index(1, [(10, 0), (20, 34)])],  # of another channel
        [index(1, [(10, len(DATA) - 30)])],  # nor does one fit
        [index(1, [(10, len(DATA))])],
        [index(1, [(10, 0), (10, 0)])],  # twice
    ],
)
def test_an_index_that_is_wrong_tells_nothing(wrong: list[bytes]) -> None:
    assert indexed(np.frombuffer(DATA, dtype=np.uint8), wrong).start.size == 0


def test_a_message_that_runs_beyond_the_end_is_none() -> None:
    buffer = np.frombuffer(DATA, dtype=np.uint8)
    whole = [index(1, [(10, 0), (30, 65)]), index(2, [(20, 34)])]
    assert indexed(buffer, whole).start.size == 3
    assert indexed(buffer[:-1], whole).start.size == 0
    assert indexed(buffer[:-6], [index(1, [(10, 0)])]).start.size == 1
    assert indexed(buffer[:31], [index(2, [(20, 0)])]).start.size == 0
    assert indexed(np.frombuffer(message(2, 20, b""), dtype=np.uint8), [index(2, [(20, 0)])]).size.tolist() == [0]
    assert indexed(buffer[:5], [index(1, [(10, 0)])]).start.size == 0


def test_times_beyond_the_signed_are_the_largest() -> None:
    times = np.array([0, 2**63 - 1, 2**63, 2**64 - 1], dtype=np.uint64)
    assert signed(times).tolist() == [0, 2**63 - 1, 2**63 - 1, 2**63 - 1]


def test_what_no_message_covers_is_a_gap() -> None:
    starts, ends = np.array([2, 10, 20]), np.array([10, 15, 30])
    assert gaps(starts, ends, 33) == [(0, 2), (15, 20), (30, 33)]
    assert gaps(starts, ends, 30) == [(0, 2), (15, 20)]
    assert gaps(np.array([0]), np.array([5]), 5) == []
    assert gaps(np.array([], dtype=np.int64), np.array([], dtype=np.int64), 4) == [(0, 4)]


def test_fields_follow_each_other_and_end_with_the_record() -> None:
    pairs = b"".join(struct.pack("<I", len(each)) + each for each in (b"a", b"x", b"b", b"yz"))
    fields = Fields(b"??" + b"\x02\x01" + struct.pack("<I", 2) + b"hi" + struct.pack("<I", len(pairs)) + pairs, 2)
    assert fields.number(2) == 0x0102
    assert fields.text() == "hi"
    assert fields.texts() == {"a": "x", "b": "yz"}
    assert fields.take(0) == b""
    for read_on in (lambda: fields.number(1), fields.text, lambda: fields.take(1)):
        with pytest.raises(ValueError, match="a record ends too early"):
            read_on()
    with pytest.raises(ValueError):
        Fields(struct.pack("<I", 1) + b"\xff").text()


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_a_chunk_unpacks_to_what_it_says(compression: str) -> None:
    pack = {"": bytes, "zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression]
    body = chunk(DATA, compression=compression, packed=pack(DATA), checksum=zlib.crc32(DATA))
    found = Chunk.of(body)
    assert (found.start, found.end, found.size, found.compression) == (3, 9, len(DATA), compression)
    assert found.records() == DATA
    short = Chunk.of(chunk(DATA, compression=compression, packed=pack(DATA[:-1])))
    with pytest.raises(ValueError, match=f"it unpacks to {len(DATA) - 1} bytes, not to {len(DATA)}"):
        short.records()
    assert short.records(cut=True) == DATA[:-1]
    with pytest.raises(ValueError, match="its checksum is wrong"):
        Chunk.of(chunk(DATA, compression=compression, packed=pack(DATA), checksum=1)).records()
    assert Chunk.of(chunk(DATA, compression=compression, packed=pack(DATA + b"more"))).records() == DATA


@pytest.mark.parametrize(
    "compression, why", [("zstd", "cannot be unpacked"), ("lz4", "cannot be unpacked"), ("br", "br")]
)
def test_a_chunk_that_cannot_be_unpacked_says_why(compression: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Chunk.of(chunk(DATA, compression=compression, packed=b"nonsense" * 9)).records()


@pytest.mark.parametrize("size, allowed", [(1 << 26, True), ((1 << 26) + 1, False)])
def test_a_chunk_may_unpack_to_64_mib_or_a_thousandfold(size: int, allowed: bool) -> None:
    with pytest.raises(ValueError, match="not to" if allowed else "it says that it unpacks to"):
        Chunk(0, 0, size, 0, "", b"x").records()
    with pytest.raises(ValueError, match="not to" if allowed else "it says that it unpacks to"):
        Chunk(0, 0, 1024 * 70_000 + (0 if allowed else 1), 0, "", bytes(70_000)).records()


def test_records_are_read_one_by_one_and_files_one_behind_the_other() -> None:
    file = MAGIC + record(1, b"\0" * 8) + DATA + MAGIC
    both = read(file + file)
    assert [(each[1], each[3], each[4]) for each in both] == [(1, 0, False), *[(5, 0, False)] * 3] * 2
    assert [each[0] for each in both[:4]] == [8, 25, 59, 90]
    assert both[1][2] == message(1, 10, b"abc")[9:]


def test_bytes_that_make_no_record_are_counted_with_the_next_one() -> None:
    found = read(MAGIC + DATA + b"\5" + bytes(30) + DATA + DATA + MAGIC)
    assert [each[1] for each in found] == [5] * 9
    assert [each[3] for each in found] == [0, 0, 0, 31, 0, 0, 0, 0, 0]


@pytest.mark.parametrize("rubbish", [bytes(7), b"\xff" * 50])
def test_a_record_before_bytes_with_which_none_begins_is_not_believed(rubbish: bytes) -> None:
    found = read(MAGIC + DATA + rubbish + DATA + DATA + MAGIC)
    assert [each[1] for each in found] == [5] * 8
    assert [each[3] for each in found] == [0, 0, len(DATA) - PLACES[2] + len(rubbish), 0, 0, 0, 0, 0]


@pytest.mark.parametrize(
    ("opcode", "size"),
    [
        (2, 8 + 8 + 4),  # footer: where the summary and its offsets begin, its checksum
        (3, 2 + 4 + 4 + 4),  # schema: number, and name, encoding and data of no length
        (4, 2 + 2 + 4 + 4 + 4),  # channel: number, schema, and topic, encoding and metadata of no length
        (5, 2 + 4 + 8 + 8),  # message: channel, sequence, two times
    ],
)
def test_a_record_of_nothing_but_fixed_fields_is_one_and_a_shorter_one_is_none(opcode: int, size: int) -> None:
    assert [each[1] for each in read(MAGIC + record(opcode, bytes(size)) + DATA + MAGIC)] == [opcode, 5, 5, 5]
    shorter = read(MAGIC + record(opcode, bytes(size - 1)) + DATA + MAGIC)
    assert [(each[1], each[3]) for each in shorter] == [(5, 9 + size - 1), (5, 0), (5, 0)]


def test_what_the_end_cuts_off_is_told() -> None:
    cut = read(MAGIC + DATA + message(1, 40, b"abc")[:-1])
    assert [each[1] for each in cut] == [5, 5, 5, 0]
    assert cut[-1][1:4] == (0, b"", 33)
    assert read(MAGIC + DATA + b"\5\1")[-1][3] == 2
    packed = record(CHUNK, chunk(DATA))
    for end in (70, 50, 49):
        *before, last = read(MAGIC + DATA + packed[:end])
        assert len(before) == 3
        assert last == (8 + len(DATA), CHUNK, packed[9:end], 0, True)
    assert read(MAGIC + DATA + packed[:48])[-1][1:] == (0, b"", 48, False)


def test_a_chunk_whose_lengths_do_not_add_up_is_none() -> None:
    good = record(CHUNK, chunk(DATA, compression="none"))
    assert [each[1] for each in read(MAGIC + good + DATA + MAGIC)] == [6, 5, 5, 5]
    for at in (9 + 28, 9 + 32 + 4):  # length of the name, of the records
        bad = bytearray(good)
        bad[at] ^= 1
        found = read(MAGIC + bytes(bad) + DATA + MAGIC)
        assert [each[1] for each in found][-3:] == [5, 5, 5]
        assert CHUNK not in [each[1] for each in found]
        assert found[0][3] > 0
