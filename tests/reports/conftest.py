"""Logs, documents and pages that the tests of the reports share."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import pytest
from tests.conftest import hurry

from towtank.vehicle import load_vehicle, save_vehicle

from .pages import Page, run


class Made(NamedTuple):
    """A report beside the JSON document of the same run."""

    path: Path
    page: Page
    document: dict[str, Any]


@pytest.fixture(scope="session")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `yaw.csv` and `surge.csv`, 12 s each."""
    folder = tmp_path_factory.mktemp("report")
    truth = load_vehicle("vlbv300")
    lagged = tuple(each.model_copy(update={"time_constant": 0.03}) for each in truth.thrusters)
    save_vehicle(truth.model_copy(update={"thrusters": lagged}), folder / "truth.toml")
    sensed = ("--sensors", "ins", "--disturbance", 0.3, "--seed", 1)
    for name in ("surge", "yaw"):
        told = ("simulate", folder / "truth.toml", f"{name}-square", "-o", folder / f"{name}.csv")
        run(*told, "--duration", 12, *sensed)
    return folder


@pytest.fixture(scope="session")
def make(logs: Path) -> Any:
    """Run a command with --report and --json and return both."""

    def make(name: str, *words: object) -> Made:
        path = logs / f"{name}.html"
        document = run(*words, "--report", path)
        return Made(path, Page(path.read_text(encoding="utf-8")), document)

    return make


@pytest.fixture(scope="session")
def learned(make: Any, logs: Path) -> Made:
    return make("learned", "learn", logs / "yaw.csv", "--vehicle", "vlbv300", "-o", logs / "learned.toml")


@pytest.fixture(scope="session")
def planned(make: Any) -> Made:
    """Two segments in a tank, searched for in a hurry, after which one of four coefficients is known too little."""
    wishes = ("--want", "X_udot,X_uu,N_rdot,N_rr", "--accuracy", "2.9%", "--minutes", 0.27)
    with hurry():
        return make("planned", "plan", "bluerov2_heavy", "--space", "5x5x2.5", *wishes)


@pytest.fixture(scope="session")
def judged(make: Any, logs: Path, learned: Made) -> Made:
    return make("judged", "validate", logs / "learned.toml", logs / "yaw.csv", "--horizon", 3)
