"""`towtank vehicle ...`."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from towtank.vehicle import catalog_names, catalog_text, load_vehicle, save_vehicle

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


def test_a_catalog_vehicle_is_copied_word_by_word(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    assert document("vehicle", "copy", "seamor", "-o", file) == {"vehicle": "seamor", "file": str(file)}
    assert file.read_text() == catalog_text("seamor")
    assert command("vehicle", "copy", "seamor", "-o", file).code == 0  # the same once more
    file.write_text(file.read_text() + "# mine\n")
    assert "there is such a file already" in refused("vehicle", "copy", "seamor", "-o", file)
    assert file.read_text().endswith("# mine\n")
    assert command("vehicle", "copy", "seamor", "-o", file, "--force").code == 0
    assert file.read_text() == catalog_text("seamor")
    assert 'did you mean "seamor"?' in refused("vehicle", "copy", "seamr", "-o", file)


def test_prior_tells_of_every_unknown(vehicle: Path) -> None:
    found = document("vehicle", "prior", vehicle)
    assert found["vehicle"] == "small"
    assert found["body"]["mass"] == 10.0
    assert found["body"]["length"] ** 3 == pytest.approx(0.01)
    unknowns = found["unknowns"]
    for name, entry in unknowns.items():
        assert entry.keys() == {"value", "std", "interval", "unit", "source", "log_normal"}, name
        low, high = entry["interval"]
        assert low < entry["value"] < high
        assert entry["source"]
        if not entry["log_normal"]:
            assert high - low == pytest.approx(3.92 * entry["std"], rel=1e-3)
            assert low + high == pytest.approx(2.0 * entry["value"], abs=1e-12)
    assert {name for name, entry in unknowns.items() if entry["log_normal"]} == {
        *("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")
    }
    assert unknowns["X_u"] == {
        "value": -3.0,
        "std": 1.5,
        "interval": pytest.approx([-5.94, -0.06], abs=1e-3),
        "unit": "N s/m",
        "source": "the vehicle's file, which states no deviation: half of it",
        "log_normal": False,
    }
    total = unknowns["X_udot"]  # 17 kg, by a factor of exp(0.98) either way
    assert 10.0 - np.array(total["interval"]) == pytest.approx([17.0 * 2.6644, 17.0 / 2.6644], rel=1e-4)
    assert total["std"] == pytest.approx(0.5 * 17.0)
    assert total["source"].startswith("physics: 1.7 times")


def test_prior_tells_of_the_table_and_of_gains_as_the_file_has_them(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    known = load_vehicle("vlbv300")
    weak = [each.model_copy(update={"gain": 0.5}) for each in known.thrusters]
    lines = {"X_uu": {"value": -60.0, "std": 20.0, "source": "a tow"}, "gain_aft_port": {"value": 0.7, "std": 0.07}}
    save_vehicle(known.model_copy(update={"prior": lines, "thrusters": weak}), path)
    unknowns = document("vehicle", "prior", path)["unknowns"]
    assert (unknowns["X_uu"]["value"], unknowns["X_uu"]["std"]) == (-60.0, 20.0)
    assert unknowns["X_uu"]["source"] == "the vehicle's file, [prior]: a tow"
    assert unknowns["gain_aft_port"]["value"] == pytest.approx(0.7)
    assert unknowns["gain_aft_port"]["std"] == pytest.approx(0.07)
    assert unknowns["gain_aft_stbd"]["value"] == pytest.approx(0.5)
    assert unknowns["gain_aft_stbd"]["std"] == pytest.approx(0.04)
    assert not unknowns["lag"]["log_normal"]
    assert {"X_uu", "gain_aft_port"} <= document("vehicle", "show", path)["prior"].keys()
    assert "X_uu, gain_aft_port" in command("vehicle", "show", path).out


@pytest.mark.parametrize("name", catalog_names())
def test_the_tables_of_the_prior_fit_80_columns_whole(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    ran = command("vehicle", "prior", name)
    assert ran.code == 0
    assert ran.err == ""
    assert "as much water as a cube of" in ran.out.splitlines()[1]
    assert max(map(len, ran.out.splitlines())) <= 80
    rows = [line.split() for line in ran.out.splitlines() if re.search(r"\[\d+\] *$", line) and " .. " in line]
    unknowns = document("vehicle", "prior", name)["unknowns"]
    assert len(rows) == len(unknowns)
    for row in rows:
        least, most = (float(row[row.index("..") + step]) for step in (-1, 1))
        assert least < most
    for unit in {entry["unit"] for entry in unknowns.values()}:
        assert unit in ran.out
    text = " ".join(ran.out.split())
    assert all(entry["source"] in text for entry in unknowns.values())


def test_prior_names_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    path.write_text(f"{SMALL}[prior]\nlatency_velocty = {{ value = 0.1, std = 0.01 }}\n")
    assert 'prior: "latency_velocty" is no unknown of small; did you mean "latency_velocity"?' in refused(
        "vehicle", "prior", path
    )
    path.write_text(f"{SMALL}[prior]\nX_uu = -3.0\n")
    assert f"{path}: prior.X_uu.std: missing" in refused("vehicle", "prior", path)
    assert "is neither a file nor a vehicle of the catalog" in refused("vehicle", "prior", "nosuch")


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
