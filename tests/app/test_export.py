"""`towtank export`: what is written, what is refused, and what is said of it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.app.commands import command, document, refused

from towtank import load_vehicle, save_vehicle
from towtank.vehicle import Posterior, Vehicle
from towtank.vehicle.posterior import coordinate


def learned(narrowed: dict[str, float]) -> Vehicle:
    """A model with a posterior whose deviations are these shares of those before the data."""
    vehicle = load_vehicle("bluerov2_heavy")
    names = list(narrowed)
    before = np.full(len(names), 0.5)
    std = before * np.array(list(narrowed.values()))
    mean = [coordinate(vehicle, name) for name in names]
    posterior = Posterior.from_covariance(names, mean, np.diag(std**2), before)
    return vehicle.model_copy(update={"posterior": posterior})


def test_targets_are_listed() -> None:
    assert "FMU" in command("export", "--list").out
    targets = document("export", "--list")["targets"]
    assert {"c", "fmu"} <= {each["name"] for each in targets}
    assert all(each["versions"] and each["writes"] for each in targets)


def test_an_export_loads_no_simulations_and_no_tables(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom towtank.app.cli import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code\n"
        "sys.exit(' '.join({'towtank.simulation', 'pyarrow', 'urllib.request'} & {*sys.modules}) or 0)"
    )
    words = ["export", "lauv", "--to", "fmu", "-o", str(tmp_path / "a.fmu")]
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False, timeout=60)
    assert (run.returncode, run.stderr) == (0, "")


def test_a_model_is_written_and_told(tmp_path: Path) -> None:
    found = document("export", "lauv", "--to", "c", "-o", tmp_path / "a.h")
    assert found["files"] == [str(tmp_path / "a.h")]
    assert found["missing"] == []
    assert found["wrench_error"] == dict.fromkeys("XYZKMN", 0.0)
    assert (tmp_path / "a.h").read_text().startswith("/*\n * towtank: c c99\n * vehicle: lauv\n")


def test_what_was_not_identified_refuses_by_its_name(tmp_path: Path) -> None:
    model, place = tmp_path / "model.toml", tmp_path / "a.h"
    save_vehicle(learned({"X_udot": 0.1, "X_uu": 0.5, "K_pdot": 0.8, "K_pp": 1.0}), model)
    line = refused("export", model, "--to", "c", "-o", place)
    assert "K_pdot, K_pp" in line
    assert "X_u" not in line
    assert not place.exists()
    assert command("export", model, "--to", "c", "-o", place, "--allow-unidentified").code == 0
    assert place.exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "MODEL: missing"),
        (["lauv"], "--to: missing"),
        (["lauv", "--to", "gazebo"], "--to"),
        (["lavu", "--to", "c"], "did you mean"),
        (["lauv", "--to", "c", "-o", "nowhere/a.h"], "does not exist"),
        (["lauv", "--to", "c", "--at-speed", "99"], "at most 20 m/s"),
        (["lauv", "--to", "c", "--at-speed", "nan"], "at most 20 m/s"),
    ],
)
def test_bad_arguments_are_a_line(arguments: list[str], said: str) -> None:
    assert said in refused("export", *arguments)
