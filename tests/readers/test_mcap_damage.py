"""MCAP that was cut, damaged, written by others: read as far as it goes, and the loss is said."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.mcap.scan import scan_mcap
from towtank.recording import Recording

from .ros_bags import Said, imu, multi_array, write_mcap2

N = 400


def run(n: int = N) -> Recording:
    t = np.arange(n) * 0.05
    return Recording.from_table(t, {"u": np.sin(t), "cmd_1": np.arange(n, dtype=float)})


def messages(n: int = N) -> list[Said]:
    said = []
    for k in range(n):
        t = 0.05 * k
        said.append(Said("/thrusters", t, "std_msgs/msg/Float64MultiArray", multi_array([k, -k])))
        said.append(
            Said("/imu", t, "sensor_msgs/msg/Imu", imu(t, "", [1, 0, 0, 0.001 * k], [0.1 * k, 0, 1], [0, 0, 9.8]))
        )
    return said


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.recording.mcap.write._CHUNK", 2000)


def chunks_of(data: bytes) -> list[tuple[int, int]]:
    """Return where the chunk records of a file stand."""
    places, at = [], 8
    while at < len(data) - 8:
        size = struct.unpack_from("<Q", data, at + 1)[0]
        if data[at] == 6:
            places.append((at, at + 9 + size))
        at += 9 + size
    return places


@pytest.mark.usefixtures("small_chunks")
def test_cut_anywhere(tmp_path: Path) -> None:
    """Every sample before the cut is there, but for those of the chunk that is cut, and none is invented."""
    whole = run()
    whole.write(tmp_path / "a.mcap")
    data = (tmp_path / "a.mcap").read_bytes()
    chunks = chunks_of(data)
    ends = [len(read_cut(tmp_path, data[:end])["u"]) for _, end in chunks]
    assert ends == sorted(ends)
    assert ends[-1] == N
    for cut in range(chunks[0][1], len(data) - 1, 211):
        part = read_cut(tmp_path, data[:cut])
        known = sum(1 for _, end in chunks if end <= cut)
        assert len(part["u"]) >= ends[known - 1]
        assert np.array_equal(part["u"].values, whole["u"].values[: len(part["u"])])
        assert any("no end" in line for line in part.repairs.lines), cut


def read_cut(folder: Path, data: bytes) -> Recording:
    (folder / "cut.mcap").write_bytes(data)
    return read(folder / "cut.mcap")


def test_the_chunk_that_is_cut_yields_what_stands_before_the_cut(tmp_path: Path) -> None:
    write_mcap2(tmp_path / "a.mcap", messages(), chunk_size=1 << 20, compression=CompressionType.NONE)
    data = (tmp_path / "a.mcap").read_bytes()
    [(start, end)] = chunks_of(data)
    part = read_cut(tmp_path, data[: (start + end) // 2])
    assert 0.45 * N < len(part["cmd_1"]) < 0.55 * N
    assert np.array_equal(part["cmd_1"].values, np.arange(len(part["cmd_1"])))


@pytest.mark.usefixtures("small_chunks")
def test_a_chunk_with_a_wrong_checksum_is_left_out_and_counted(tmp_path: Path) -> None:
    run().write(tmp_path / "a.mcap")
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    chunks = chunks_of(data)
    start, end = chunks[3]
    data[start + 9 + 24] ^= 1  # the checksum
    part = read_cut(tmp_path, bytes(data))
    lost = N - len(part["u"])
    assert 0 < lost < 2 * N / len(chunks)
    assert part.repairs.damaged == lost
    assert any(f"chunk at byte {start} left out: its checksum is wrong" in line for line in part.repairs.lines)
    garbled = bytes(data[: start + 60]) + bytes(end - start - 60) + bytes(data[end:])
    assert len(read_cut(tmp_path, garbled)["u"]) == N - lost


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("at", [0, 4, 9 + 28, 9 + 40])
def test_reading_goes_on_behind_bytes_that_make_no_record(tmp_path: Path, at: int) -> None:
    """Opcode, length, name and size of a chunk: whatever is destroyed, the chunks behind it are found."""
    run().write(tmp_path / "a.mcap")
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    start, _ = chunks_of(data)[2]
    data[start + at] ^= 0x40
    part = read_cut(tmp_path, bytes(data))
    assert N - 100 < len(part["u"]) < N
    assert part["u"].t[-1] == run()["u"].t[-1]
    assert part.repairs.damaged > 0


@pytest.mark.usefixtures("small_chunks")
def test_chunks_that_stand_twice_overlap_or_are_out_of_order(tmp_path: Path) -> None:
    run().write(tmp_path / "a.mcap")
    data = (tmp_path / "a.mcap").read_bytes()
    chunks = chunks_of(data)
    (a, b), (c, d) = chunks[1], chunks[4]
    twice = read_cut(tmp_path, data[:d] + data[a:b] + data[c:d] + data[d:])
    assert twice["u"] == run()["u"]
    assert any("stand twice" in line for line in twice.repairs.lines)
    swapped = read_cut(tmp_path, data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:])
    assert swapped["u"] == run()["u"]
    assert swapped.repairs.disorder > 0


def test_two_files_one_behind_the_other(tmp_path: Path) -> None:
    first, second = messages()[:300], [said._replace(t=said.t + 100.0) for said in messages()[:200]]
    a = write_mcap2(tmp_path / "a.mcap", first).read_bytes()
    b = write_mcap2(tmp_path / "b.mcap", list(reversed(second))[::-1]).read_bytes()
    both = read_cut(tmp_path, a + b)
    assert len(both["cmd_1"]) == 250
    assert both.duration > 100.0
    assert len(read_cut(tmp_path, a + a)["cmd_1"]) == 150


@pytest.mark.parametrize("compression", list(CompressionType), ids=lambda each: each.name)
@pytest.mark.parametrize("more", [{}, {"use_chunking": False}, {"index_types": 0, "enable_crcs": False}], ids=str)
def test_whatever_the_writer_was_told(tmp_path: Path, compression: CompressionType, more: dict) -> None:
    if "index_types" in more:
        from mcap.writer import IndexType

        more = {**more, "index_types": IndexType.NONE}
    path = write_mcap2(tmp_path / "a.mcap", messages(), compression=compression, **more)
    found = read(path)
    assert np.array_equal(found["cmd_1"].values, np.arange(N))
    assert np.allclose(found["p"].values, 0.1 * np.arange(N))
    assert not found.repairs
    unended = read(write_mcap2(tmp_path / "b.mcap", messages(), compression=compression, end=False, **more))
    assert unended["cmd_1"] == found["cmd_1"]


def test_the_bytes_of_every_message_are_those_of_the_library(tmp_path: Path) -> None:
    path = write_mcap2(tmp_path / "a.mcap", messages(), chunk_size=3000)
    with path.open("rb") as stream:
        told: dict[str, list[tuple[int, bytes]]] = {}
        for _, channel, message in make_reader(stream).iter_messages():
            told.setdefault(channel.topic, []).append((message.log_time, message.data))
    topics = scan_mcap(path, lambda heading: True).topics
    assert {topic.name for topic in topics} == set(told)
    for topic in topics:
        assert topic.raw is not None
        assert list(zip(topic.log_time.tolist(), topic.raw.messages(), strict=True)) == told[topic.name]
        assert topic.raw.message(7) == told[topic.name][7][1]


def test_an_index_that_lies_is_not_believed(tmp_path: Path) -> None:
    path = write_mcap2(tmp_path / "a.mcap", messages(), chunk_size=3000)
    data = bytearray(path.read_bytes())
    at, changed = 8, 0
    while at < len(data) - 8:
        size = struct.unpack_from("<Q", data, at + 1)[0]
        if data[at] == 7:
            for entry in range(at + 9 + 6 + 8, at + 9 + size, 16):
                data[entry] ^= 0x11
                changed += 1
        at += 9 + size
    assert changed > N
    found = read_cut(tmp_path, bytes(data))
    assert np.array_equal(found["cmd_1"].values, np.arange(N))


def test_chunks_that_claim_to_be_huge_are_left_out_at_once(tmp_path: Path) -> None:
    stream = BytesIO()
    writer = Writer(stream)
    writer.start()
    channel = writer.register_channel("/a", "json", 0)
    writer.add_message(channel, 1, b"{}", 1)
    writer.finish()
    data = stream.getvalue()
    [(start, end)] = chunks_of(data)
    for size in (1 << 62, 1 << 40, 1 << 31):
        bomb = bytearray(data)
        struct.pack_into("<Q", bomb, start + 9 + 16, size)
        with pytest.raises(InputError, match=rf"no message in it \(1 damaged message.*unpacks to {size} bytes"):
            read_cut(tmp_path, bytes(bomb))
    assert end > start


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89MCAP0\r\n", "no message in it"),
        (b"\x89MCAP1\r\n" + bytes(100), "expected the first bytes of MCAP version 0"),
        (b"\x89MCAP0\r\n" + bytes(100_000), "no message in it"),
        (b"\x89MCAP0\r\n" + b"\x06\xff\xff\xff\xff\xff\x00\x00\x00" * 20_000, "no message in it"),
        (b"\x89MCAP", "found b'.x89MCAP'"),
    ],
)
def test_empty_and_foreign_files_are_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        read_cut(tmp_path, content)
    assert "\n" not in str(raised.value)


def test_the_records_are_understood_as_the_library_does(tmp_path: Path) -> None:
    run().write(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        chunks = [record for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Chunk)]
    assert sum(chunk.uncompressed_size for chunk in chunks) == N * (31 + 12 + 16)
