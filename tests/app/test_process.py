"""What the process of a command takes of the machine: free memory goes back, linear algebra takes one thread."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

HELD = """
import sys
import numpy as np
from towtank.app.cli import return_what_is_free
if sys.argv[1] == "return":
    return_what_is_free()
def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6
del_first = np.ones(1_000_000)
del del_first
arrays = [np.ones(500_000) for _ in range(40)]
full = resident()
last = arrays.pop()
arrays.clear()
print(full - resident())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a matter of the C library of Linux")
def test_what_is_freed_below_something_that_stays_goes_back() -> None:
    def given_back(word: str) -> float:
        return float(subprocess.run([sys.executable, "-c", HELD, word], check=True, capture_output=True).stdout)

    assert given_back("return") > 140.0  # of 156 MB


ONE_THREAD = """
import os, sys
import towtank.app.cli as cli
assert "numpy" not in sys.modules  # which reads the variable when it is imported
cli.app = lambda: print(os.environ["OPENBLAS_NUM_THREADS"])
cli.main()
"""


@pytest.mark.parametrize(("told", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_linear_algebra_takes_one_thread_unless_the_user_says_otherwise(told: dict[str, str], threads: str) -> None:
    others = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    told = others | told
    found = subprocess.run([sys.executable, "-c", ONE_THREAD], check=True, capture_output=True, text=True, env=told)
    assert found.stdout.strip() == threads
