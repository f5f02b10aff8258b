"""What others do to the file of a recording under way: taken away, cut, moved, written by two."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from towtank.errors import InputError
from towtank.readers import read
from towtank.recording.event import EVENT_TOPIC, Event
from towtank.recording.mcap.log import McapLog, Quantity


def begun(path: Path) -> McapLog:
    log = McapLog.open(path, source="by hand", attributes={"vehicle": "seamor"})
    log.source("gyro", [Quantity("r", "rad/s", "FRD")])
    write(log, 0, 300)
    log.write_raw("udp", 1.0, b"packet")
    assert log.flush()
    return log


def write(log: McapLog, first: int, last: int) -> None:
    for k in range(first, last):
        log.write("gyro", 0.01 * k, float(k))
        if k % 50 == 49:
            log.flush()


def independent(path: Path) -> list[float]:
    """Return the times [s] that the package mcap finds by the file's index."""
    with path.open("rb") as stream:
        messages = make_reader(stream, validate_crcs=True).iter_messages(topics=["/gyro"])
        return [message.log_time * 1e-9 for _, _, message in messages]


def test_a_folder_that_is_removed_is_made_anew_with_all_that_was_recorded(tmp_path: Path) -> None:
    (tmp_path / "dives").mkdir()
    log = begun(tmp_path / "dives" / "a.mcap")
    shutil.rmtree(tmp_path / "dives")
    write(log, 300, 600)
    log.close()
    assert log.complete
    assert log.lost == 0
    assert [text.endswith("what it held is written anew under its name") for text in log.incidents] == [True]
    run = read(tmp_path / "dives" / "a.mcap")
    assert np.array_equal(run["r"].values, np.arange(600.0))
    assert len(independent(tmp_path / "dives" / "a.mcap")) == 600


def test_a_name_that_was_taken_meanwhile_is_left_to_its_owner(tmp_path: Path) -> None:
    log = begun(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").unlink()
    (tmp_path / "a.mcap").write_text("of somebody else")
    write(log, 300, 400)
    log.close()
    assert (tmp_path / "a.mcap").read_text() == "of somebody else"
    assert log.path == tmp_path / "a-2.mcap"
    assert len(read(log.path)["r"]) == 400


@pytest.mark.parametrize("left", [0.0, 0.001, 0.5, 0.9])
def test_a_file_that_is_cut_goes_on_behind_what_is_left(left: float, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    log = begun(path)
    size = path.stat().st_size
    os.truncate(path, round(left * size))
    write(log, 300, 600)
    log.close(["ended"])
    run = read(path)
    assert log.complete
    assert np.array_equal(run["r"].values[-300:], np.arange(300.0, 600.0))  # all that came afterwards
    assert (run.attributes["vehicle"], run.source) == ("seamor", "by hand")
    assert len(run["r"]) + log.lost >= 600  # what was cut off is counted, the packet with it
    assert log.lost <= 301
    assert f"{size - round(left * size)} bytes were cut off" in log.incidents[0]
    assert len(independent(path)) == len(run["r"])


def test_a_file_that_is_moved_is_written_on_under_its_new_name(tmp_path: Path) -> None:
    log = begun(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").rename(tmp_path / "b.mcap")
    write(log, 300, 600)
    log.close()
    assert log.incidents == [f"{tmp_path / 'a.mcap'} was moved; it is written on under its new name"]
    assert len(read(tmp_path / "b.mcap")["r"]) == 600


def test_a_second_writer_is_refused_and_the_first_one_unharmed(tmp_path: Path) -> None:
    log = begun(tmp_path / "a.mcap")
    before = (tmp_path / "a.mcap").read_bytes()
    with pytest.raises(InputError, match="another session is recording to it"):
        McapLog.resume(tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == before
    log.close()
    McapLog.resume(tmp_path / "a.mcap").close()


class FullDisk:
    """A disk that takes nothing while it is `full`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full, self._write = True, os.write
        monkeypatch.setattr("towtank.recording.mcap.log.os.write", self.write)

    def write(self, descriptor: int, data: bytes) -> int:
        if self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return self._write(descriptor, data)


def test_what_waits_for_a_full_disk_is_written_once_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = begun(tmp_path / "a.mcap")
    disk = FullDisk(monkeypatch)
    write(log, 300, 600)
    assert not log.flush()
    assert "No space left" in log.trouble
    log.source("depth", [Quantity("z", "m", "NED")])
    log.write("depth", 0.3, 2.0)
    assert not log.flush()
    disk.full = False
    assert log.flush()
    assert log.trouble == ""
    log.close()
    assert (log.lost, log.complete) == (0, True)
    run = read(tmp_path / "a.mcap")
    assert (len(run["r"]), run["z"].values.tolist()) == (600, [2.0])


def test_a_disk_that_stays_full_leaves_what_was_recorded_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = begun(tmp_path / "a.mcap")
    before = (tmp_path / "a.mcap").read_bytes()
    FullDisk(monkeypatch)
    write(log, 300, 600)
    log.close()
    assert (log.lost, log.complete) == (300, False)
    assert (tmp_path / "a.mcap").read_bytes() == before
    assert len(read(tmp_path / "a.mcap")["r"]) == 300


@pytest.mark.parametrize("number, refused", [(errno.EACCES, True), (errno.EAGAIN, True), (errno.ENOLCK, False)])
def test_a_disk_without_locks_is_written_and_one_that_is_locked_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, refused: bool
) -> None:
    begun(tmp_path / "a.mcap").close()

    def flock(descriptor: int, how: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("towtank.recording.mcap.log.fcntl.flock", flock)
    if refused:
        with pytest.raises(InputError, match="another session is recording to it"):
            McapLog.resume(tmp_path / "a.mcap")
        with pytest.raises(InputError, match="cannot be written"):
            McapLog.open(tmp_path / "b.mcap")
        assert not (tmp_path / "b.mcap").exists()
    else:
        McapLog.resume(tmp_path / "a.mcap").close()
        McapLog.open(tmp_path / "b.mcap").close()
        assert (tmp_path / "b.mcap").exists()


def test_of_a_file_without_its_beginning_nothing_is_left_and_it_begins_anew(tmp_path: Path) -> None:
    log = begun(tmp_path / "a.mcap")
    os.truncate(tmp_path / "a.mcap", 3)
    write(log, 300, 400)
    log.close()
    [incident] = log.incidents
    assert "301 samples and packets in them; it goes on" in incident
    assert log.lost == 301
    run = read(tmp_path / "a.mcap")
    assert run["r"].values.tolist() == [float(k) for k in range(300, 400)]
    assert "301 samples could not be written" in " ".join(run.notes)


def test_what_is_said_of_a_recording_may_be_taken_back(tmp_path: Path) -> None:
    log = begun(tmp_path / "a.mcap")
    log.describe({"room": "tank 2", "water": "fresh"})
    log.describe({"room": None, "water": "salt"})
    log.close()
    found = read(tmp_path / "a.mcap").attributes
    assert ("room" in found, found["water"]) == (False, "salt")


def test_what_is_said_of_a_recording_waits_for_a_disk_as_samples_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = begun(tmp_path / "a.mcap")
    disk = FullDisk(monkeypatch)
    for k in range(3):
        log.write_event(Event(float(k), "mark", f"event {k}"))
    log.write_raw("other", 1.0, b"packet")
    assert not log.flush()
    log.describe({"room": "tank 2"})
    disk.full = False
    log.close()
    assert log.lost == 0
    with (tmp_path / "a.mcap").open("rb") as stream:
        found = [(each.log_time, each.data) for _, _, each in make_reader(stream).iter_messages(topics=[EVENT_TOPIC])]
    assert [time for time, _ in found] == [0, 10**9, 2 * 10**9]
    assert [b'"event %d"' % k in data for k, (_, data) in enumerate(found)] == [True] * 3
    assert read(tmp_path / "a.mcap").attributes["room"] == "tank 2"


def test_times_before_1970_and_after_2262_stand_at_the_ends(tmp_path: Path) -> None:
    log = begun(tmp_path / "a.mcap")
    log.write_raw("udp", -5.0, b"early")
    log.write_raw("udp", 1e12, b"late")
    log.close()
    with (tmp_path / "a.mcap").open("rb") as stream:
        found = {
            message.data: message.log_time for _, _, message in make_reader(stream).iter_messages(topics=["/raw/udp"])
        }
    assert found == {b"packet": 10**9, b"early": 0, b"late": 2**63 - 1}


def test_a_folder_within_a_folder_that_is_removed_is_made_anew(tmp_path: Path) -> None:
    (tmp_path / "dives" / "today").mkdir(parents=True)
    log = begun(tmp_path / "dives" / "today" / "a.mcap")
    shutil.rmtree(tmp_path / "dives")
    write(log, 300, 600)
    log.close()
    assert len(read(tmp_path / "dives" / "today" / "a.mcap")["r"]) == 600
