"""Models learned from real recordings with nothing tuned, judged by free-running prediction of others.

All of them, with those that fall short, are printed by `benchmarks/studies/real_study.py`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_recordings
from towtank.recording import Recording

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from real_cases import BOAT_HALVES, POOL, Case, Learned, boat, pool, real_fit, sea, wrongly_wired


@pytest.fixture(scope="module")
def pool_runs(data: Path) -> Learned:
    return _there(pool(data))


@pytest.fixture(scope="module")
def boat_logs(data: Path) -> Learned:
    return _there(boat(data))


def _there(runs: Learned) -> Learned:
    if not runs.folder.is_dir():
        pytest.skip(f"no such recordings: {runs.folder} is not a folder")
    return runs


SHORT = {  # what is reached where it falls short of what is asked
    "pitch_roll_1 + all_2 -> pitch_roll_2: p": 60.0,
    "pitch_roll_1 + all_2 -> all_3 by 3 s: p": 54.0,
}
FIGURES = [  # of yaw `learn` itself is asked: app/test_real_log.py
    pytest.param(case, name, least, id=f"{case.name}: {name}")
    for case in POOL
    for name, least in case.least
    if "yaw" not in case.name
]


@pytest.mark.parametrize("case, name, least", FIGURES)
def test_pool(pool_runs: Learned, case: Case, name: str, least: float) -> None:
    fit = real_fit(pool_runs.learn(*case.learned), pool_runs.read(case.judged), case.horizon)
    assert fit[name] >= SHORT.get(f"{case.name}: {name}", least)
    if fit[name] < least:
        pytest.xfail(f"{fit[name]:.1f} %, {least:g} % asked")


def test_the_choice_between_filter_and_free_runs_is_told_with_figures(pool_runs: Learned) -> None:
    run = pool_runs.read("yaw_1").window(0.0, 12.0)
    learning = learn_recordings(pool_runs.vehicle, [run], method="output-error")
    assert any("not fitted to" in text and "%" in text for text in learning.remarks)
    assert not any(each.what == "thrusters" for each in learning.findings)


def test_speeds_that_the_pool_did_not_measure_are_not_learned_from_gyros(pool_runs: Learned) -> None:
    run = pool_runs.read("yaw_1").without("ax", "ay", "az")
    estimate = learn_recordings(pool_runs.vehicle, [run], free_runs=False).estimate
    claimed = [name for name in ("X_udot", "X_uu", "Y_vdot", "Y_vv", "W_minus_B") if estimate[name].identified]
    assert not claimed


@pytest.fixture(scope="module")
def first_half_at_sea(data: Path) -> tuple[LogLearning, Sequence[Recording]]:
    if not (data / "bluerov2_dvl_sea_2026").is_dir():
        pytest.skip(f"no such recordings: {data / 'bluerov2_dvl_sea_2026'} is not a folder")
    vehicle, halves = sea(data)
    return learn_recordings(vehicle, [halves[0]]), halves


@pytest.mark.parametrize("i", [0, 1, 2, 5])
def test_inertias_at_sea_are_those_of_a_body_in_water(
    first_half_at_sea: tuple[LogLearning, Sequence[Recording]], i: int
) -> None:
    learning, _ = first_half_at_sea
    total = float(np.diag(learning.model.mass_matrix)[i] / np.diag(learning.vehicle.rigid_body_matrix)[i])
    assert 1.0 <= total <= 5.0


def test_sea_surge_of_the_second_half(first_half_at_sea: tuple[LogLearning, Sequence[Recording]]) -> None:
    learning, halves = first_half_at_sea
    assert not any(each.what == "thrusters" for each in learning.findings)
    assert real_fit(learning, halves[1])["u"] >= 71.0


def test_boat_is_learned_in_the_plane(boat_logs: Learned) -> None:
    learning = boat_logs.learn("222", "223")
    assert not any(each.what == "thrusters" for each in learning.findings)
    out_of_plane = [c for c in learning.estimate.coefficients if c.name[0] in "ZKM" or c.name == "W_minus_B"]
    claimed = [c.name for c in out_of_plane if c.identified]
    assert not claimed
    assert learning.estimate["X_udot"].identified


@pytest.mark.parametrize("half", BOAT_HALVES, ids="+".join)
def test_the_swapped_outputs_of_the_boat_are_found(boat_logs: Learned, half: tuple[str, ...]) -> None:
    vehicle = wrongly_wired(boat_logs.vehicle)
    learning = learn_recordings(vehicle, [boat_logs.read(name) for name in half], method="paper")
    assert any("the outputs of thrusters 1 (left) and 2 (right) are swapped" in each.text for each in learning.findings)
    assert learning.model.thrusters[0].position == pytest.approx(boat_logs.vehicle.thrusters[0].position)
