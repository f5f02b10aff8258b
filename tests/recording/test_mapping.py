"""Mapping files: what they say reaches the channels; what is wrong in them is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.recording import Column, ColumnMapping, load_mapping, read_csv

CONTRACT = """
thrusters = ["pwm1", "pwm2"]
body = "FRD"
world = "NED"
[columns]
t = "time"
p = "gyro_p"
psi = { from = "yaw_deg", scale = 0.017453292519943295, offset = 0.0 }
"""


def save(folder: Path, text: str) -> Path:
    path = folder / "map.toml"
    path.write_text(text)
    return path


def table(folder: Path, header: str, rows: int = 6) -> Path:
    path = folder / "dive.csv"
    names = header.split(",")
    lines = [",".join(str(10 * i + k) for k in range(len(names))) for i in range(rows)]
    path.write_text(header + "\n" + "\n".join(lines) + "\n")
    return path


def test_the_example_of_the_contract(tmp_path: Path) -> None:
    dive = table(tmp_path, "time,pwm1,pwm2,gyro_p,yaw_deg,u,v")
    run = read_csv(dive, save(tmp_path, CONTRACT))
    assert run.names == ("p", "psi", "cmd_1", "cmd_2")
    assert np.array_equal(run["p"].t, np.arange(6) * 10.0)
    assert np.array_equal(run["cmd_2"].values, np.arange(6) * 10.0 + 2)
    assert np.allclose(run["psi"].values, np.deg2rad(np.arange(6) * 10.0 + 4))
    assert run.notes == ("ignored columns: u, v",)


def test_scale_offset_and_milliseconds(tmp_path: Path) -> None:
    mapping = ColumnMapping.model_validate(
        {"columns": {"t": {"from": "ms", "scale": 0.001}, "z": {"from": "d", "scale": -2.0, "offset": 1.0}}}
    )
    run = read_csv(table(tmp_path, "ms,d"), mapping)
    assert np.allclose(run["z"].t, np.arange(6) * 0.01)
    assert np.allclose(run["z"].values, 1.0 - 2.0 * (np.arange(6) * 10.0 + 1))


def test_rate_stands_in_for_time(tmp_path: Path) -> None:
    run = read_csv(table(tmp_path, "a,b"), ColumnMapping.model_validate({"rate": 50, "columns": {"u": "b"}}))
    assert np.allclose(run["u"].t, np.arange(6) / 50)


def test_a_column_named_t_is_the_time(tmp_path: Path) -> None:
    run = read_csv(table(tmp_path, "t,b"), ColumnMapping.model_validate({"columns": {"u": "b"}}))
    assert np.allclose(run["u"].t, np.arange(6) * 10.0)


BAD = {
    'boddy = "FRD"': 'unknown key "boddy"; did you mean "body"?',
    'psi = "yaw"': 'unknown key "psi"; channels stand under [columns]',
    'body = "flu"': "body: found 'flu', expected 'FRD' or 'FLU'",
    "rate = -1.0": "rate: found -1.0, expected greater than 0",
    'rate = 1.0\n[columns]\nt = "time"': "rate and columns.t are both given",
    '[columns]\nphy = "roll"': 'columns: unknown channel "phy"; did you mean "phi"?',
    '[columns]\ncmd_ = "roll"': 'columns: unknown channel "cmd_"',
    '[columns]\nphi = { form = "roll" }': 'missing key "columns.phi.from"',
    '[columns]\nphi = { from = "roll", scal = 2 }': 'unknown key "columns.phi.scal"; did you mean "scale"?',
    '[columns]\nphi = { from = "roll", scale = "2 deg" }': "columns.phi.scale: found '2 deg', expected number",
    '[columns]\nphi = { from = "roll", scale = 0 }': "columns.phi.scale: found 0",
    '[columns]\nphi = { from = "roll", offset = inf }': "columns.phi.offset: found inf, expected a finite number",
    "[columns]\nphi = 3": "columns.phi: found 3",
    '[columns]\nqw = "a"\nqx = "b"': "columns: found qw qx, expected all of qw qx qy qz or none",
    '[columns]\nqw="a"\nqx="b"\nqy="c"\nqz="d"\nphi="e"': "columns: found both Euler angles and a quaternion",
    'thrusters = ["a"]\n[columns]\ncmd_port = "b"': "thrusters and columns.cmd_... are both given",
    'thrusters = "a"': "thrusters: found 'a', expected tuple",
    "[marker]\nposition = [1.0, 2.0]": 'missing key "marker.position.2"',
    '[marker]\nposition = [1.0, 2.0, 3.0]\nof = ["mass"]': "marker.of.0: found 'mass'",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_mappings_are_named_by_file_and_key(tmp_path: Path, text: str) -> None:
    path = save(tmp_path, text)
    with pytest.raises(InputError) as error:
        load_mapping(path)
    assert str(error.value).startswith(f"{path}: {BAD[text]}"), str(error.value)


def test_broken_toml_and_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"map\.toml:2:\d+: not valid TOML: "):
        load_mapping(save(tmp_path, "body = 'FRD'\nrate 3\n"))
    with pytest.raises(InputError, match=r"none\.toml: no such mapping file"):
        load_mapping(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ('[columns]\nu = "spede"', r'map\.toml: no column "spede" in .*; did you mean "speed"\?; it has time, sp'),
        ('[columns]\nu = "speed"', r'map\.toml: .*dive\.csv has no column "t"; name its time under \[columns\]'),
        ('thrusters = ["pwm1"]\n[columns]\nt = "time"', r'no column "pwm1" in'),
        ("rate = 10.0", "names no measurement"),
    ],
)  # fmt: skip
def test_mappings_that_do_not_fit_the_table(tmp_path: Path, mapping: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_csv(table(tmp_path, "time,speed,b"), save(tmp_path, mapping))


def test_text_in_a_mapped_column_is_found_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "dive.csv"
    path.write_text("mode,time,speed\nA,0,1\nA,1,fast\n")
    mapping = ColumnMapping.model_validate({"columns": {"t": "time", "u": "speed"}})
    with pytest.raises(InputError, match=r'dive\.csv:3:3: found "fast" in column "speed"'):
        read_csv(path, mapping)


def test_one_source_column_may_serve_twice(tmp_path: Path) -> None:
    mapping = ColumnMapping.model_validate({"rate": 10.0, "thrusters": ["b", {"from": "b", "scale": -1.0}]})
    run = read_csv(table(tmp_path, "a,b"), mapping)
    assert np.array_equal(run["cmd_1"].values, -run["cmd_2"].values)


def test_a_scale_and_an_offset_are_applied_whichever_is_there() -> None:
    values = np.array([1.0, -2.0, np.nan])
    assert Column(source="a").apply(values) is values
    for scale, offset in ((1.0, -3.0), (1.0, 3.0), (-1.0, 0.0), (2.0, 0.0), (0.5, 1.0)):
        found = Column(source="a", scale=scale, offset=offset).apply(values)
        np.testing.assert_array_equal(found, scale * values + offset)
