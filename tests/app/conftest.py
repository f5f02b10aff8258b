"""Files that the tests of the command line work on."""

from __future__ import annotations

import json
import pickle
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from towtank.identification import logs
from towtank.vehicle import load_vehicle, save_vehicle
from towtank.vehicle.thrusters.wiring import Wiring

from .commands import command, document

BENCH = "pwm,force_N\n" + "".join(
    f"{pwm},{0.0 if abs(pwm - 1500) < 25 else 4e-4 * (pwm - 1500) * abs(pwm - 1500):.6g}\n"
    for pwm in range(1100, 1901, 20)
)


SENSED = ("--sensors", "ins", "--disturbance", 0.3, "--seed", 1)


_asked = logs.wiring_of


@lru_cache(16)  # questions are megabytes
def _wiring_of(question: bytes) -> Wiring:
    return _asked(pickle.loads(question))


@pytest.fixture(autouse=True)
def _a_wiring_is_asked_for_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dozens of commands are given the same log, and each asks for as long as it learns how the thrusters are wired."""
    monkeypatch.setattr(logs, "wiring_of", lambda problem: _wiring_of(pickle.dumps(problem)))


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with simulated logs: `surge.csv`, `yaw.csv`, a learned model and what was said of it, a bench test.

    Thrusters answer within 30 ms, which nobody who learns from the logs is told.
    """
    folder = tmp_path_factory.mktemp("workshop")
    truth = load_vehicle("vlbv300")
    lagged = tuple(each.model_copy(update={"time_constant": 0.03}) for each in truth.thrusters)
    save_vehicle(truth.model_copy(update={"thrusters": lagged}), folder / "truth.toml")
    words = ("simulate", folder / "truth.toml", "--rate", 50)
    for name in ("surge", "yaw"):
        ran = command(*words, f"{name}-square", "-o", folder / f"{name}.csv", "--duration", 30, *SENSED)
        assert ran.code == 0, ran
    told = document("learn", folder / "yaw.csv", "--vehicle", "vlbv300", "-o", folder / "learned.toml")
    (folder / "learned.json").write_text(json.dumps(told))
    (folder / "bench.csv").write_text(BENCH)
    return folder


@pytest.fixture(scope="session")
def learned_document(workshop: Path) -> dict[str, Any]:
    """What `learn` said of `yaw.csv`, everything plausible being free."""
    found: dict[str, Any] = json.loads((workshop / "learned.json").read_text())
    return found
