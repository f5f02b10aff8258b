"""Real logs through a mapping file to the grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.recording import align, bind_thrusters, load_mapping, read_csv


def find(data: Path, pattern: str) -> Path:
    found = sorted(data.glob(pattern))
    if not found:
        pytest.skip(f"no {pattern} in {data}")
    return found[0]


def test_pool_log_by_pwm_and_gyros(data: Path, tmp_path: Path) -> None:
    path = find(data, "bluerov_pool_2016/yaw_1_*.csv")
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]\n[columns]\n'
        'p = "gyro_p"\nq = "gyro_q"\nr = "gyro_r"\nax = "acc_x"\nay = "acc_y"\naz = "acc_z"\n'
    )
    run = bind_thrusters(read_csv(path, load_mapping(mapping)), [f"t{k}" for k in range(1, 7)])
    assert run.names == ("p", "q", "r", "ax", "ay", "az", *(f"cmd_t{k}" for k in range(1, 7)))
    assert not run.repairs
    grid = align(run, commands=[f"t{k}" for k in range(1, 7)])
    assert grid.rate == 100.0
    assert len(grid) == len(run["r"])
    clean = grid.fresh[:, 11]
    assert np.allclose(grid.velocity[clean, 5], run["r"].values[clean], atol=1e-12)
    assert np.array_equal(grid.commands[:, 2], run["cmd_t3"].values)
    assert not np.isnan(grid.velocity[1:-1, 3:]).any()
    assert grid.repairs.spikes < 0.01 * len(grid)
    assert -11 < np.median(grid.acceleration[:, 2]) < -8


def test_surface_craft_with_heading_in_degrees(data: Path, tmp_path: Path) -> None:
    path = find(data, "blueboat_2024/log_220.csv")
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'thrusters = ["pwm_left", "pwm_right"]\n[columns]\nx = "north_m"\ny = "east_m"\nu = "u"\nv = "v"\nr = "r"\n'
        "psi = { from = 'yaw_deg', scale = 0.017453292519943295 }\n"
    )
    run = read_csv(path, mapping)
    assert run["psi"].values[0] == pytest.approx(np.deg2rad(188.685211))
    grid = align(run)
    assert grid.rate == 10.0
    assert np.abs(np.diff(grid.pose[:, 5])).max() < 0.5
    turned = np.trapezoid(grid.velocity[:, 5], grid.t)
    assert grid.pose[-1, 5] - grid.pose[0, 5] == pytest.approx(turned, abs=0.3)


def test_dvl_of_its_own_rate(data: Path) -> None:
    run = read_csv(find(data, "bluerov2_dvl_sea_2026/dvl_8hz.csv"))
    grid = align(run)
    assert grid.repairs.gaps > 0
    assert np.isnan(grid.velocity[:, 0]).any()
    assert 5.0 < grid.rate < 12.0
