"""Every target, with vehicles as nobody expects them: what is written can be read in its own language."""

from __future__ import annotations

import io
import re
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML
from scipy.io import loadmat
from tests.exporters.compiled import Compiled, built
from tests.exporters.odd import BODY, CURVES, IDLE, VEHICLES, odd, thruster
from tests.exporters.whole import random_commands

from towtank import InputError, export, import_vehicle, thruster_wrench
from towtank.exporters import TARGETS

NAMES = [each.name for each in TARGETS]
COMPILED = ("whole", "name: signs", "name: digit", "names of thrusters", "in air", "numbers near zero")  # as FMUs


def read(path: Path) -> None:
    """Read a file in its own language. Whatever is wrong with it raises."""
    data = path.read_bytes()
    match path.suffix:
        case ".sdf" | ".urdf" | ".xml" | ".config":
            ET.fromstring(data)
        case ".py":
            compile(data, str(path), "exec")
            assert path.stem.isidentifier()
        case ".m":
            assert path.stem.isidentifier()
            assert re.search(rb"^function [^\n]*?[a-z]\w{,62}\(", data, re.MULTILINE)
        case ".yaml":
            YAML(typ="safe", pure=True).load(data)
        case ".mat":
            loadmat(path)
        case ".h":
            program = path.with_suffix(".c")
            program.write_text(f'#include "{path.name}"\nint main(void) {{ return 0; }}\n')
            strict = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wno-unused-function"]
            ran = subprocess.run(
                ["gcc", "-std=c99", *strict, "-fsyntax-only", program], capture_output=True, text=True, check=False
            )
            assert ran.returncode == 0, ran.stderr
        case ".fmu":
            archive = zipfile.ZipFile(io.BytesIO(data))
            root = ET.fromstring(archive.read("modelDescription.xml"))
            names = [each.get("name") for each in root.iter() if each.get("valueReference") is not None]
            assert len(names) == len(set(names)) > 0
        case other:
            raise AssertionError(other)
    if path.suffix not in (".mat", ".fmu"):
        assert not re.search(rb"[^\n -~]", data), "not plain ASCII"


@pytest.mark.filterwarnings("error")
@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
@pytest.mark.parametrize("key", VEHICLES)
@pytest.mark.parametrize("target", NAMES)
def test_any_vehicle_is_written_so_that_it_can_be_read(
    target: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if target == "fmu" and key not in COMPILED:
        pytest.skip("compiled: a few are enough")
    monkeypatch.chdir(tmp_path)
    done = export(VEHICLES[key], target)
    said = "\n".join(done.heading.lines)
    for words in ("towtank: ", "vehicle: ", "source: ", "sha256 ", "missing:", "largest error of the wrench"):
        assert words in said
    assert len(said.splitlines()) == len(done.heading.lines)
    assert set(tmp_path.rglob("*")) >= {tmp_path / each for each in done.files}
    for each in done.files:
        read(each)


@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
@pytest.mark.parametrize("key", ["whole", "name: signs"])
@pytest.mark.parametrize("target", NAMES)
def test_what_is_written_over_has_the_same_bytes(
    target: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first, again = ({each: each.read_bytes() for each in export(VEHICLES[key], target).files} for _ in range(2))
    assert first == again


@pytest.mark.parametrize("key", VEHICLES)
@pytest.mark.parametrize("target", ["gz-sim", "urdf-hydrodynamics"])
def test_any_vehicle_comes_back_with_the_same_bytes(target: str, key: str, tmp_path: Path) -> None:
    first = export(VEHICLES[key], target, tmp_path / "one").files
    found = import_vehicle(next(each for each in first if each.suffix in (".sdf", ".urdf")))
    second = export(found.vehicle, target, tmp_path / "two").files
    assert found.left == ()
    for before, after in zip(first, second, strict=True):
        assert before.name == after.name
        assert before.read_bytes() == after.read_bytes(), before.name


@pytest.mark.parametrize("key", IDLE)
@pytest.mark.parametrize("target", [each for each in NAMES if each not in ("fmu", "gz-sim")])
def test_a_thruster_that_never_pushes_is_written(
    target: str, key: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    files = export(odd(thrusters=[thruster("idle", curve=IDLE[key])]), target).files
    assert files
    for each in files:
        read(each)  # in its own language


@pytest.mark.parametrize("key", IDLE)
def test_gazebo_has_no_range_for_a_thruster_that_never_pushes(key: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^idle: its curve gives no force at any command"):
        export(odd(thrusters=[thruster("idle", curve=IDLE[key])]), "gz-sim", tmp_path)


@pytest.mark.parametrize("target", ["gz-sim", "urdf-hydrodynamics"])
def test_a_vehicle_that_is_lifted_down_is_refused_where_there_is_no_such_water(target: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="buoyant force comes out as -"):
        export(odd(restoring={"W_minus_B": 200.0}), target, tmp_path)


def test_what_gains_energy_without_its_products_of_inertia_is_refused(tmp_path: Path) -> None:
    body = {**BODY, "centre_of_gravity": [1.0, 1.0, 0.0]}
    vehicle = odd(rigid_body=body, hydrodynamics={})
    assert export(vehicle, "c", tmp_path / "a.h").error.max() == 0.0
    with pytest.raises(InputError, match="urdf-hydrodynamics can say of its mass and inertia is not positive definite"):
        export(vehicle, "urdf-hydrodynamics", tmp_path)


def test_every_curve_is_the_same_in_c(tmp_path: Path) -> None:
    each = {**CURVES, **IDLE}
    vehicle = odd(
        thrusters=[thruster(f"t{k}", curve=curve, gain=1.0 + 0.1 * k) for k, curve in enumerate(each.values())]
    )
    commands = random_commands(vehicle, 500)
    header = Compiled(built(vehicle, tmp_path), single=False)
    found = header.call("wrenches", [commands, 0.0], 6)[0]
    expected = thruster_wrench(vehicle, commands)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_a_name_never_leads_out_of_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    monkeypatch.chdir(inside)
    for target in ("c", "gz-sim", "urdf-hydrodynamics", "python"):
        export(VEHICLES["name: path"], target)
    assert list(tmp_path.iterdir()) == [inside]


@pytest.mark.parametrize(
    ("output", "words"),
    [("x" * 300 + ".h", "File name too long"), ("/proc/x.h", "cannot write in /proc"), ("none/x.h", "does not exist")],
)
def test_a_place_that_cannot_be_written_is_one_line(
    output: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words):
        export("lauv", "c", output)
    with pytest.raises(InputError, match=r"cannot be written|does not exist"):
        export("lauv", "gz-sim", output)
