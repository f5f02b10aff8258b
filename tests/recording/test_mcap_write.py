"""Our MCAP: exact to the bit, in order of time, and legible to the libraries of others."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from towtank.errors import InputError
from towtank.readers import read
from towtank.recording import Channel, ColumnMapping, Content, Recording
from towtank.recording.channel import standard_channel
from towtank.recording.repairs import Repairs
from towtank.recording.standard import is_standard


def bits(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values).tobytes()


def same(a: Recording, b: Recording) -> bool:
    """Whether two recordings are equal to the last bit, signs of zero and payloads of NaN included."""
    return (
        a == b
        and a.names == b.names
        and all(bits(a[name].t) == bits(b[name].t) and bits(a[name].values) == bits(b[name].values) for name in a)
    )


def session() -> Recording:
    """Several rates, holes, foreign channels, and everything that a recording says of itself."""
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(-2.0, 60.0, 5000))
    slow = np.arange(300) * 0.2 + 1e-9
    u = rng.normal(size=t.size)
    u[[0, 7, 8]] = np.nan, -0.0, 5e-324
    u[100] = struct.unpack("<d", struct.pack("<Q", 0x7FF8_0000_0000_BEEF))[0]
    channels = [
        standard_channel("cmd_aft-port 1", slow, rng.normal(size=300)),
        standard_channel("u", t, u),
        standard_channel("psi", t, rng.normal(size=t.size)),
        standard_channel("voltage", slow[:0], slow[:0]),
        Channel("Größe°", slow, slow, "furlong", "FRD"),
        Channel("t", slow, slow),
        Channel("while", slow, -slow),
    ]
    return Recording(
        {channel.name: channel for channel in channels},
        source="tank 3",
        notes=("first", "zweitens: ±"),
        attributes={"epoch": "2025-04-10T21:25:31.472918+00:00", "clock": "recorder"},
        repairs=Repairs(disorder=3, dead=("p", "q"), details=("2 spikes in u",), damaged=1967),
        contents=(
            Content("IMU[0]", "DataFlash", 12, 25.0, ("p", "q"), ""),
            Content("GPS", "DataFlash", 1, None, (), "under water"),
        ),
    )


def test_the_round_trip_is_exact(tmp_path: Path) -> None:
    run = session()
    run.write(tmp_path / "a.mcap")
    again = read(tmp_path / "a.mcap")
    assert same(run, again)
    assert again["cmd_aft-port 1"].t is again["Größe°"].t


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.text(min_size=1, max_size=8),
            arrays(np.int64, st.integers(1, 6), elements=st.integers(-(10**15), 10**15), unique=True),
        ),
        min_size=1,
        max_size=5,
        unique_by=lambda pair: pair[0],
    )
)
def test_any_names_times_and_values(tmp_path_factory: pytest.TempPathFactory, drawn: list) -> None:
    channels = [
        Channel(name if not is_standard(name) else f"_{name}", 1e-9 * np.unique(ns), 1e85 * np.unique(ns)[::-1])
        for name, ns in drawn
    ]
    run = Recording({channel.name: channel for channel in channels})
    path = tmp_path_factory.mktemp("any") / "a.mcap"
    run.write(path)
    assert same(run, read(path))


def test_others_read_it(tmp_path: Path) -> None:
    """mcap itself finds every checksum right and all in order of time; rosbags decodes every field by its name."""
    run = session()
    run.write(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        times = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
        assert times == sorted(times)
        assert summary.statistics is not None
        assert summary.statistics.message_count == len(times) == 5300
        assert sum(summary.statistics.channel_message_counts.values()) == 5300
        assert {channel.topic for channel in summary.channels.values()} >= {"/u_psi", "/voltage"}
        stream.seek(0)
        assert sum(1 for _ in StreamReader(stream, validate_crcs=True).records) > 5300
    with AnyReader([tmp_path / "a.mcap"]) as bag:
        found = {connection.topic: connection for connection in bag.connections}
        said = [bag.deserialize(raw, c.msgtype) for c, _, raw in bag.messages([found["/u_psi"]])]
        texts = found["/u_psi"].msgdef.data
        assert "float64 psi  # rad, NED-FRD" in texts
        assert bits(np.array([each.psi for each in said])) == bits(run["psi"].values)
        assert bits(np.array([each.t for each in said])) == bits(run["psi"].t)


def test_log_times_tell_the_instant(tmp_path: Path) -> None:
    run = session()
    run.write(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        first = next(make_reader(stream).iter_messages())[2].log_time
    epoch = 1744320331472918000
    assert abs(first - (epoch + run.start * 1e9)) <= 1000.0


def test_a_mapping_reads_it_too(tmp_path: Path) -> None:
    run = session()
    run.write(tmp_path / "a.mcap")
    mapping = ColumnMapping.model_validate({"columns": {"r": {"from": "/u_psi.psi", "scale": 2.0}}})
    again = read(tmp_path / "a.mcap", mapping)
    assert again.names == ("r",)
    assert np.array_equal(again["r"].values, 2.0 * run["psi"].values)
    with pytest.raises(InputError, match=r'no "/u_psi\.psy".*did you mean "/u_psi\.psi"'):
        read(tmp_path / "a.mcap", ColumnMapping.model_validate({"columns": {"r": "/u_psi.psy"}}))


def test_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = session()
    run.write(tmp_path / "a.mcap")
    before = (tmp_path / "a.mcap").read_bytes()

    def broken(self: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("towtank.recording.mcap.container.McapFile.finish", broken)
    with pytest.raises(KeyboardInterrupt):
        run.without("u").write(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_another_version_or_unit_is_refused(tmp_path: Path) -> None:
    run = Recording.from_table(np.arange(5.0), {"u": np.arange(5.0)})
    run.write(tmp_path / "a.mcap")
    whole = (tmp_path / "a.mcap").read_bytes()
    key = struct.pack("<I", 7) + b"towtank" + struct.pack("<I", 1)
    assert key + b"1" in whole
    (tmp_path / "b.mcap").write_bytes(whole.replace(key + b"1", key + b"2"))
    with pytest.raises(InputError, match="version 2 of the format"):
        read(tmp_path / "b.mcap")
    columns = json.dumps([["u", "m/s", "FRD"]]).encode()
    assert columns in whole
    (tmp_path / "c.mcap").write_bytes(whole.replace(columns, columns.replace(b"m/s", b"kmh")))
    with pytest.raises(InputError, match=r'c\.mcap: /u: channel "u": found unit "kmh"'):
        read(tmp_path / "c.mcap")
