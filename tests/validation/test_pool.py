"""Real recordings from a pool: learned on one run, judged on the next by free-running prediction."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_paper
from towtank.recording import Recording, load_mapping, read_csv
from towtank.validation import validate
from towtank.vehicle import Vehicle, load_vehicle

GYROS = """
thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]
[columns]
p = "gyro_p"
q = "gyro_q"
r = "gyro_r"
ax = "acc_x"
ay = "acc_y"
az = "acc_z"
"""


class Pool:
    """The recordings by name, read once."""

    def __init__(self, folder: Path, mapping: Path) -> None:
        self.folder, self.mapping = folder, mapping
        self.vehicle: Vehicle = load_vehicle("bluerov_2016")
        self.read = cache(self._read)
        self.learn = cache(self._learn)

    def _read(self, name: str) -> Recording:
        found = sorted(self.folder.glob(f"{name}_2016*.csv"))
        if not found:
            pytest.skip(f"no {name}_2016*.csv in {self.folder}")
        return read_csv(found[0], load_mapping(self.mapping))

    def _learn(self, *names: str) -> LogLearning:
        return learn_paper(self.vehicle, [self.read(name) for name in names])

    def fit(self, learned: tuple[str, ...], judged: str, horizon: float | None = None) -> dict[str, float | None]:
        return validate(self.learn(*learned).model, [self.read(judged)], horizon=horizon).fit


@pytest.fixture(scope="module")
def pool(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Pool:
    folder = data / "bluerov_pool_2016"
    if not folder.is_dir():
        pytest.skip(f"no pool recordings: {folder} is not a folder")
    mapping = tmp_path_factory.mktemp("pool") / "map.toml"
    mapping.write_text(GYROS)
    return Pool(folder, mapping)


def test_yaw_1_predicts_yaw_2(pool: Pool) -> None:
    assert pool.fit(("yaw_1",), "yaw_2")["r"] >= 72.0  # type: ignore[operator]


def test_yaw_1_and_2_predict_yaw_3(pool: Pool) -> None:
    assert pool.fit(("yaw_1", "yaw_2"), "yaw_3")["r"] >= 53.0  # type: ignore[operator]


@pytest.mark.parametrize("names", [("yaw_1",), ("yaw_2",), ("yaw_1", "yaw_2")], ids=" ".join)
def test_the_yaw_inertia_and_the_delay_are_plausible(pool: Pool, names: tuple[str, ...]) -> None:
    learning = pool.learn(*names)
    assert 0.0 <= learning.delay <= 0.060
    found = next(total for total in learning.estimate.sums if total.name == "I_z - N_rdot")
    assert 0.7 < found.value < 1.25
    assert found.std < 0.35


@pytest.mark.parametrize("names", [("yaw_1",), ("yaw_2",), ("yaw_3",), ("yaw_1", "yaw_2")], ids=" ".join)
def test_damping_is_physical_or_said_to_be_inseparable(pool: Pool, names: tuple[str, ...]) -> None:
    estimate = pool.learn(*names).estimate
    linear, quadratic = estimate["N_r"], estimate["N_rr"]
    assert linear.identified or quadratic.identified
    for one in (linear, quadratic):
        assert one.value <= 0.0
        if not one.identified:
            assert "cannot be told apart" in str(one.reason)


def test_speeds_that_the_pool_did_not_measure_are_not_learned(pool: Pool) -> None:
    for c in pool.learn("yaw_1").estimate.coefficients:
        if c.name[0] in "XYZ" or c.name == "W_minus_B":
            assert not c.identified
            assert "not measured" in str(c.reason)


def test_pitch_and_roll_1_predict_2(pool: Pool) -> None:
    fit = pool.fit(("pitch_roll_1",), "pitch_roll_2", horizon=5.0)
    assert fit["p"] >= 55.0  # type: ignore[operator]
    assert fit["q"] >= 55.0  # type: ignore[operator]


def test_the_righting_moment_is_about_what_is_known(pool: Pool) -> None:
    righting = pool.learn("pitch_roll_1").estimate["BG_z"]
    assert righting.identified
    assert 0.6 < righting.value < 2.6
    assert np.isfinite(righting.std)
