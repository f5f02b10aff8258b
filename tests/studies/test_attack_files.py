"""The attack on files, cut short, and that it would see what it looks for."""

from __future__ import annotations

import random
import sys
import warnings
from pathlib import Path

import pytest

from towtank.errors import InputError
from towtank.readers import read

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import attack_exchange
import attack_files
from hostile_logs import STORMS, WRITERS, hostile, storm
from small_logs import SMALL_LOGS

KINDS = list(SMALL_LOGS)


@pytest.fixture(autouse=True)
def no_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The limits of memory and time are those of a process of the study's own."""
    monkeypatch.setattr(attack_files, "limit_process", lambda: None)
    monkeypatch.setattr(attack_files.signal, "alarm", lambda seconds: 0)


def test_nothing_breaks() -> None:
    found = attack_files.attacked(range(300, 300 + 3 * len(KINDS)), KINDS)
    assert found.faults == []
    assert set(found.files) == set(KINDS)
    assert found.read.total() > len(KINDS) / 2


@pytest.mark.parametrize("kind", WRITERS)
def test_hostile_logs_are_read_or_refused_in_a_line(kind: str, tmp_path: Path) -> None:
    """With warnings as errors: no library says a word."""
    for seed in range(12):
        name, suffix, data = hostile(kind, random.Random(f"test {kind} {seed}"))
        path = tmp_path / f"log{suffix}"
        path.write_bytes(data)
        assert not _wrong_refusal(path), (seed, name)


@pytest.mark.parametrize("kind", STORMS)
def test_storms_of_tiny_records_take_linear_time(kind: str, tmp_path: Path) -> None:
    for seed in range(2):
        suffix, data = storm(kind, random.Random(f"test {kind} {seed}"), 100_000)
        path = tmp_path / f"log{suffix}"
        path.write_bytes(data)
        assert not _wrong_refusal(path), seed


def _wrong_refusal(path: Path) -> str:
    """Read a file; return what is wrong with the refusal, "" where it is right, or the file is read."""
    try:
        read(path)
    except InputError as error:
        return attack_files._what_is_wrong(str(error), path)
    return ""


def escapes(path: Path) -> None:
    raise KeyError("x")


def warns(path: Path) -> None:
    warnings.warn("overflow encountered in square", RuntimeWarning, stacklevel=1)


def refuses_badly(path: Path) -> None:
    raise InputError(f"{path}: list index out of range")


def names_no_file(path: Path) -> None:
    raise InputError("found nothing, expected something")


@pytest.mark.parametrize(
    ("does", "kind"),
    [
        (escapes, "traceback"),
        (warns, "library warning"),
        (refuses_badly, "refusal not said"),
        (names_no_file, "refusal not said"),
    ],
)
def test_each_fault_is_seen(does, kind: str, tmp_path: Path) -> None:
    found = attack_files.Outcome()
    with attack_files._watched(found, tmp_path / "a.csv", "seed 1, csv, flip, read"):
        does(tmp_path / "a.csv")
    assert [fault.kind for fault in found.faults] == [kind]


def test_a_model_without_its_promise_is_half_written(tmp_path: Path) -> None:
    found = attack_files.Outcome()
    model = tmp_path / "model.toml"
    model.write_text('name = "x"', encoding="utf-8")
    (tmp_path / "left.tmp").write_text("", encoding="utf-8")
    attack_files._check_outputs(found, tmp_path / "a.csv", "seed 1, csv, flip", model, 2)
    assert [fault.kind for fault in found.faults] == ["half written"] * 3


def test_a_finding_can_be_repeated() -> None:
    for kind in KINDS:
        assert attack_files._file(kind, random.Random("7"))[2:] == attack_files._file(kind, random.Random("7"))[2:]


def test_models_of_simulators_are_read_or_refused_in_a_line() -> None:
    found = attack_exchange.attack(range(200))
    assert found.wrong == ()
    assert found.read > 20
    assert found.refused > 50
