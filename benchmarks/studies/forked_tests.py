"""Runs tests over and over, each time in a fork of one process that has loaded the libraries: half a second, not five.

    python forked_tests.py FILE_OR_FOLDER... < requests > answers

A request is a line of JSON, {"tests": [...], "first_only": true, "limit": seconds}, the answer another, {"failed":
[...], "hung": false}: the tests that fail, or that they took longer. The files and folders tell what is loaded once:
all that their tests import, but for what lies in the tree itself, which each fork reads anew. Ends with its input, or
by SIGTERM.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import signal
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from covering_tests import OUTCOMES, PYTEST

_ROOT = Path.cwd().resolve()
_QUIET = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # of plugins that are loaded already


class _Fork:
    """A fork of this process in which pytest runs, in a group of processes of its own."""

    def __init__(self, words: Sequence[str], names: Path | None = None) -> None:
        """`words`: for pytest. `names`: file for the names of the modules that it loads and that are not the tree's."""
        self._pid = os.fork()
        if self._pid:
            return
        code = 70
        try:
            os.setpgid(0, 0)  # to be ended with all that its tests start
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            nothing = os.open(os.devnull, os.O_RDWR)
            for each in (0, 1, 2):
                os.dup2(nothing, each)
            sys.dont_write_bytecode = names is None  # of a mutant
            code = int(pytest.main([*PYTEST[2:], *_QUIET, *words]))
            if names is not None:
                names.write_text("\n".join(each for each, module in sys.modules.items() if not _of_the_tree(module)))
        finally:
            os._exit(code)

    def wait(self, limit: float) -> int | None:
        """Return how pytest ended, None if it did not within `limit` [s]; nothing of it goes on."""
        until, code = time.monotonic() + limit, None
        while code is None and time.monotonic() < until:
            pid, status = os.waitpid(self._pid, os.WNOHANG)
            if pid:
                code = os.waitstatus_to_exitcode(status)
            else:
                time.sleep(0.01)
        self.end()
        if code is None:
            os.waitpid(self._pid, 0)
        return code

    def end(self) -> None:
        """End it, with the processes that its tests started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._pid, signal.SIGKILL)


def main(places: Sequence[str]) -> None:
    """Load what the tests of these files and folders import, then answer requests."""
    sys.path.insert(0, str(_ROOT))
    names = _ROOT / "modules.txt"
    _Fork(["--collect-only", *places], names).wait(600.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in names.read_text().splitlines() if names.is_file() else ():
            with contextlib.suppress(Exception):  # then each fork loads it
                importlib.import_module(name)
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        print(json.dumps(_answer(**json.loads(line))), flush=True)


def _answer(tests: Sequence[str], first_only: bool, limit: float) -> dict[str, Any]:
    outcomes, chosen = _ROOT / "outcomes.json", _ROOT / "chosen.txt"
    outcomes.unlink(missing_ok=True)
    chosen.write_text("\n".join(tests) + "\n")
    os.environ[OUTCOMES] = str(outcomes)
    fork = _Fork([*(["-x"] if first_only else []), f"@{chosen}"])

    def stop(number: int, frame: FrameType | None) -> None:
        fork.end()
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, stop)
    code = fork.wait(limit)
    signal.signal(signal.SIGTERM, before)
    failed = json.loads(outcomes.read_text())["failed"] if code and outcomes.is_file() else []
    return {"failed": failed or ([f"pytest ended with {code}"] if code else []), "hung": code is None}


def _of_the_tree(module: Any) -> bool:
    """Whether a module is read from files of the tree, or is none that can be imported by its name."""
    spec = getattr(module, "__spec__", None)
    places = [getattr(module, "__file__", None), *(getattr(spec, "submodule_search_locations", None) or ())]
    return spec is None or any(Path(each).resolve().is_relative_to(_ROOT) for each in places if each)


if __name__ == "__main__":
    main(sys.argv[1:])
