"""A hundred broken files of each kind: nothing escapes but one line that says why (the study has 10,000)."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest
from tests.pace import within

from towtank.errors import InputError
from towtank.readers import read

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from mutations import MUTATIONS, mutated
from small_logs import SMALL_LOGS, small_logs

RUNS = 100
LONGEST = 2.0  # s


@pytest.fixture(scope="module")
def logs() -> dict[str, tuple[str, bytes]]:
    return small_logs()


@pytest.mark.parametrize("kind", SMALL_LOGS)
def test_nothing_escapes(kind: str, logs: dict[str, tuple[str, bytes]], tmp_path: Path) -> None:
    suffix, whole = logs[kind]
    others = [data for name, (_, data) in logs.items() if name != kind]
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(whole)
    whole_run = read(path)
    assert whole_run.duration > 1.0
    assert not whole_run.repairs.damaged
    outcomes = []
    for seed in range(RUNS):
        name, data = mutated(whole, others, random.Random(f"test {kind} {seed}"))
        path.write_bytes(data)
        with within(LONGEST, (seed, name)):
            try:
                outcomes.append(bool(len(read(path))))
            except InputError as error:
                message = str(error)
                assert message.startswith(str(path)), (seed, name, message)
                assert "\n" not in message
    assert len(outcomes) > RUNS / 20  # a good part of them can still be read


def test_every_mutation_changes_something() -> None:
    data = bytes(range(256)) * 40
    for name, mutation in MUTATIONS.items():
        assert any(mutation(bytearray(data), [b"other" * 99], random.Random(k)) != data for k in range(9)), name


def test_a_mutation_can_be_repeated() -> None:
    data = bytes(range(256)) * 40
    assert mutated(data, [b"x" * 99], random.Random(5)) == mutated(data, [b"x" * 99], random.Random(5))


@pytest.mark.parametrize("suffix", [".BIN", ".log", ".tlog", ".csv", ".parquet", ".mcap", ".bag", ".db3", ".mat", ""])
@pytest.mark.parametrize(
    "content", [b"\0", b"\xa3\x95", b"hello", b"\xfd" * 5000, b"\xa3\x95\x80" * 3000, b"{}\n" * 50]
)
def test_what_is_no_log_at_all(suffix: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / f"file{suffix}"
    path.write_bytes(content)
    with within(1.0), pytest.raises(InputError, match="file") as found:
        read(path)
    assert "\n" not in str(found.value)
