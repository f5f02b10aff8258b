"""The process that designs segments: it answers, it refuses in words, it may die, and it ends with its session."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

from towtank import InputError, load_vehicle
from towtank.app.live.designing import Designer
from towtank.planning.coach import Next

ASKED = ("X_udot", "X_uu"), 0.9
ORPHAN = """
import os, signal, sys, time
from towtank import load_vehicle
from towtank.app.live.designing import Designer
if __name__ == "__main__":
    print(Designer(load_vehicle("bluerov2_heavy"))._process.pid, flush=True)
    time.sleep(2.0)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def answered(designer: Designer) -> Next:
    deadline = time.monotonic() + 90.0
    while time.monotonic() < deadline:
        found = designer.answer()
        if found is not None:
            return found
        time.sleep(0.05)
    raise AssertionError("no answer")


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as stat:  # noqa: PTH123
        return stat.read().rpartition(")")[2].split()[0] != "Z"


def test_it_answers_refuses_and_comes_back() -> None:
    vehicle = load_vehicle("bluerov2_heavy")
    designer = Designer(vehicle)
    try:
        assert not designer.designs
        designer.ask(vehicle, *ASKED, sensors="pose")
        assert designer.designs
        assert answered(designer).unmet == ()
        assert not designer.designs
        designer.ask(vehicle, *ASKED, sensors="sonar")
        with pytest.raises(InputError, match=r'--sensors: found "sonar"'):
            answered(designer)
        os.kill(designer._process.pid or 0, signal.SIGKILL)
        designer._process.join()
        designer.ask(vehicle, *ASKED, sensors="pose")  # another process
        assert answered(designer).unmet == ()
        os.kill(designer._process.pid or 0, signal.SIGSTOP)  # else it may answer before it ends
        designer.ask(vehicle, *ASKED, sensors="pose")
        os.kill(designer._process.pid or 0, signal.SIGKILL)
        with pytest.raises(InputError, match="the process that designs segments has ended"):
            answered(designer)
        assert not designer.designs
    finally:
        designer.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are looked up in /proc")
def test_it_ends_with_a_session_that_is_killed(tmp_path: object) -> None:
    script = f"{tmp_path}/orphan.py"
    with open(script, "w") as file:  # noqa: PTH123
        file.write(ORPHAN)
    session = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    assert session.stdout is not None
    pid = int(session.stdout.readline())
    assert session.wait() == -signal.SIGKILL
    deadline = time.monotonic() + 60.0
    while alive(pid):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    session.stdout.close()
