"""`towtank vehicle ...`."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from towtank.vehicle import catalog_names, load_vehicle, save_vehicle

from .commands import command, document, refused

SMALL = """
name = "small"
[rigid_body]
mass = 10.0
inertia = [0.3, 0.3, 0.3]
[hydrodynamics]
"""


@pytest.fixture
def vehicle(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(f"{SMALL}X_u = -3.0\n")
    return path


def test_list_names_the_whole_catalog() -> None:
    entries = document("vehicle", "list")["vehicles"]
    assert tuple(entry["name"] for entry in entries) == catalog_names()
    assert all(entry["mass"] > 0.0 for entry in entries)
    out = command("vehicle", "list").out
    assert all(name in out for name in catalog_names())


@pytest.mark.parametrize("name", catalog_names())
def test_show(name: str) -> None:
    found = document("vehicle", "show", name)
    assert found["name"] == name
    assert found["coefficients"]["W_minus_B"]["unit"] == "N"
    assert all({"value", "std", "unit", "source"} <= entry.keys() for entry in found["coefficients"].values())
    ran = command("vehicle", "show", name)
    assert ran.code == 0
    assert ran.err == ""
    assert "Coefficients" in ran.out


def test_show_tells_deviation_and_source(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    path.write_text(f'{SMALL}X_uu = {{ value = -61.117, std = 0.42, source = "tank of 2020 [a, b]" }}\n')
    out = command("vehicle", "show", path).out
    assert "-61.12" in out
    assert "0.42" in out
    assert "tank of 2020 [a, b]" in out


def test_show_tells_of_a_posterior(vehicle: Path) -> None:
    assert document("vehicle", "show", vehicle)["posterior"] is None
    assert "Posterior" not in command("vehicle", "show", vehicle).out
    table = (
        'names = ["X_u", "delay"]\nmean = [-3, 0.1]\nstd = [0.5, 0.01]\nprior_std = [4, 0.05]\ncholesky = [[1], [3, 4]]'
    )
    vehicle.write_text(f"{SMALL}X_u = -3.0\n[posterior]\n{table}\n")
    out = command("vehicle", "show", vehicle).out
    assert "Posterior with its covariance, over 2 unknowns" in out
    assert "X_u, delay" in out
    assert document("vehicle", "show", vehicle)["posterior"] == {
        "names": ["X_u", "delay"],
        "mean": [-3.0, 0.1],
        "std": [0.5, 0.01],
        "prior_std": [4.0, 0.05],
        "cholesky": [[1.0], [3.0, 4.0]],
    }


def test_check(vehicle: Path) -> None:
    assert document("vehicle", "check", vehicle) == {"file": str(vehicle), "ok": True, "warnings": []}
    assert "can be read, physical, no warnings" in " ".join(command("vehicle", "check", vehicle).out.split())


def test_check_warns_of_an_indefinite_mass(vehicle: Path) -> None:
    vehicle.write_text(f"{SMALL}X_udot = 25.0\nX_u = -3.0\n")
    found = document("vehicle", "check", vehicle)
    assert found["ok"] is False
    assert any("not positive definite" in text for text in found["warnings"])
    ran = command("vehicle", "check", vehicle)
    assert ran.code == 0
    assert "not physical" in ran.out


def test_check_of_what_cannot_be_read(vehicle: Path) -> None:
    vehicle.write_text(f"{SMALL}X_uuu = -3.0\n")
    ran = command("vehicle", "check", vehicle, "--json")
    assert ran.code == 2
    assert '"ok": false' in ran.out
    assert "X_uuu" in ran.err
    assert 'did you mean "X_uu"?' in ran.err
    assert ran.err.count("\n") == 1


def test_a_vehicle_that_learn_wrote_can_be_shown(workshop: Path, tmp_path: Path) -> None:
    found = document("vehicle", "show", workshop / "learned.toml")
    assert found["coefficients"]["N_rdot"]["std"] > 0.0
    copy = tmp_path / "copy.toml"
    save_vehicle(load_vehicle(str(workshop / "learned.toml")), copy)
    assert copy.read_text() == (workshop / "learned.toml").read_text()


def test_fit_thruster(workshop: Path, tmp_path: Path) -> None:
    curve, plot = tmp_path / "curve.toml", tmp_path / "plot.png"
    ran = command("vehicle", "fit-thruster", workshop / "bench.csv", "-o", curve, "--plot", plot)
    assert ran.code == 0, ran
    assert plot.read_bytes().startswith(b"\x89PNG")
    found = tomllib.loads(curve.read_text())["curve"]
    assert found["kind"] == "polynomial"
    assert "curve = {" in ran.out
    assert "o measured, . fitted" in ran.out
    pasted = tmp_path / "v.toml"
    line = curve.read_text().splitlines()[-1]
    pasted.write_text(
        f'{SMALL}X_u = -3.0\n[[thrusters]]\nname = "a"\nposition = [0, 0, 0]\ndirection = [1, 0, 0]\n{line}\n'
    )
    assert document("vehicle", "check", pasted)["ok"] is True


def test_fit_thruster_document(workshop: Path) -> None:
    found = document("vehicle", "fit-thruster", workshop / "bench.csv", "--kind", "table")
    assert found["curve"]["kind"] == "table"
    assert found["forward"]["r_squared"] > 0.999
    assert tomllib.loads(found["toml"])["curve"]["command"] == found["curve"]["command"]


def test_fit_thruster_refuses(workshop: Path, tmp_path: Path) -> None:
    bench = tmp_path / "bench.csv"
    bench.write_text("pwm,force_N\n1100,-3\n1200,x\n")
    assert f"{bench}:3:2" in refused("vehicle", "fit-thruster", bench)
    assert "no column" in refused("vehicle", "fit-thruster", workshop / "surge.csv")
    assert ".toml or .png" in refused("vehicle", "fit-thruster", workshop / "bench.csv", "-o", "curve.txt")
    assert "does not exist" in refused(
        "vehicle", "fit-thruster", workshop / "bench.csv", "--plot", tmp_path / "no/a.png"
    )
