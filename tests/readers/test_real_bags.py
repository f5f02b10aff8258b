"""Real recordings in ROS 1 bags and in MCAP, against the tables that were taken from them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_paper
from towtank.readers import read
from towtank.recording import ColumnMapping, Recording
from towtank.recording.grids.free_motion import free_motion
from towtank.vehicle import load_vehicle

BAG = ColumnMapping.model_validate(
    {
        "thrusters": [f"/rovio/thrusters.data[{k}]" for k in range(6)],
        "columns": {name: f"/rovio/imu/data.data[{k}]" for k, name in enumerate(("p", "q", "r", "ax", "ay", "az"), 1)},
    }
)
CSV = ColumnMapping.model_validate(
    {
        "thrusters": [f"pwm{k}" for k in range(1, 7)],
        "columns": {"p": "gyro_p", "q": "gyro_q", "r": "gyro_r", "ax": "acc_x", "ay": "acc_y", "az": "acc_z"},
    }
)


def find(data: Path, pattern: str) -> list[Path]:
    found = sorted(data.glob(pattern))
    if not found:
        pytest.skip(f"no {pattern} in {data}")
    return found


def test_every_bag_and_every_mcap_is_read(data: Path) -> None:
    for path in [*find(data, "bluerov_pool_2016/orig_bags/*.bag"), *find(data, "torpedo_auv_mcap_2025/*.mcap")]:
        run = read(path)
        assert not run.repairs, path
        assert all(each.used or each.reason for each in run.contents), path


def table(path: Path) -> dict[str, np.ndarray]:
    rows = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    return {name: rows[name] for name in rows.dtype.names}


@pytest.fixture(scope="module")
def torpedo(data: Path) -> tuple[Recording, Path]:
    [path] = find(data, "torpedo_auv_mcap_2025/*.mcap")
    return read(path), path.parent


def test_the_clocks_of_the_torpedo_are_reconciled_and_named(torpedo: tuple[Recording, Path]) -> None:
    run, _ = torpedo
    assert any("5.96 days (514944.04" in note and "behind the recorder's clock" in note for note in run.notes)
    assert run.attributes["epoch"].startswith("2025-04-10T21:25:31.47")


@pytest.mark.parametrize(
    ("file", "columns"), [("dvl.csv", {"u": "u", "v": "v", "w": "w"}), ("depth.csv", {"z": "depth_m"})]
)
def test_the_torpedos_dvl_and_depth(torpedo: tuple[Recording, Path], file: str, columns: dict[str, str]) -> None:
    """The same numbers, at the sensor's times (to a microsecond), on the clock of the recorder (to its delays)."""
    run, folder = torpedo
    known = table(folder / file)
    if "valid" in known:  # where the bottom was lost there is no velocity
        known = {name: values[known["valid"]] for name, values in known.items()}
    for name, column in columns.items():
        assert np.array_equal(run[name].values, known[column]), name
        shift = run[name].t - known["t_stamp"]
        assert np.ptp(shift) < 2e-6
        late = known["t_log"] - run[name].t
        assert np.ptp(late - np.median(late)) < 0.02
        assert abs(np.median(late)) < 0.002


def test_the_torpedos_imu(torpedo: tuple[Recording, Path]) -> None:
    """Without stamps, at the times of recording; its rates are refused: they are degrees per second."""
    run, folder = torpedo
    known = table(folder / "imu.csv")
    signs = {"ax": 1.0, "ay": -1.0, "az": -1.0}
    for name, sign in signs.items():
        assert np.array_equal(run[name].values, sign * known[name])
    assert np.ptp(run["ax"].t - known["t_log"]) < 1e-6
    assert len(run["qw"]) == len(known["qw"])
    reason = next(each.reason for each in run.contents if each.name == "/coug2/modem_imu")
    assert "degrees per second" in reason
    assert np.median(run["az"].values) == pytest.approx(-9.9, abs=0.2)


def test_the_torpedos_commands_by_a_mapping(data: Path) -> None:
    [path] = find(data, "torpedo_auv_mcap_2025/*.mcap")
    known = table(path.parent / "command.csv")
    topic = "/coug2/controls/command"
    thrusters = [f"{topic}.thruster", *(f"{topic}.fin[{k}]" for k in range(4))]
    run = read(path, ColumnMapping.model_validate({"thrusters": thrusters}))
    for k, name in enumerate(("thruster", "fin1", "fin2", "fin3", "fin4"), 1):
        assert np.array_equal(run[f"cmd_{k}"].values, known[name])


def test_what_is_not_used_is_said(torpedo: tuple[Recording, Path]) -> None:
    run, _ = torpedo
    reasons = {each.name: each.reason for each in run.contents}
    assert reasons["/coug2/fix"] == "satellites are not seen under water"
    assert "dead reckoning" in reasons["/coug2/dvl/dead_reckoning"]
    assert reasons["/coug2/dvl/velocity"].startswith("velocity: /coug2/dvl/data is nearer the sensor")
    assert "never changes" in reasons["/coug2/leak/data"]
    assert "fin[4], thruster" in reasons["/coug2/controls/command"]
    assert len(run.contents) == 33


class Pool:
    """Runs of the pool, as bag and as table of the same stretch: from the first command to the last."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.vehicle = folder, load_vehicle("bluerov_2016")
        self.both = cache(self._both)
        self.learn = cache(self._learn)

    def _both(self, name: str) -> tuple[Recording, Recording]:
        [bag], [csv] = find(self.folder, f"orig_bags/{name}_*.bag"), find(self.folder, f"{name}_*.csv")
        whole, known = read(bag, BAG), read(csv, CSV)
        start = float(whole["cmd_1"].t[0])
        return whole.window(start, start + known.end), known

    def _learn(self, name: str) -> tuple[LogLearning, LogLearning]:
        bag, csv = self.both(name)
        return learn_paper(self.vehicle, [bag]), learn_paper(self.vehicle, [csv])


@pytest.fixture(scope="module")
def pool(data: Path) -> Pool:
    return Pool(data / "bluerov_pool_2016")


RUNS = ("yaw_1", "yaw_2", "yaw_3")


@pytest.mark.parametrize("name", [*RUNS, "pitch_roll_1", "all_3"])
def test_the_pools_bags_hold_what_its_tables_hold(pool: Pool, name: str) -> None:
    bag, csv = pool.both(name)
    start = bag["cmd_1"].t[0]
    for channel in ("p", "q", "r"):
        inner = slice(3, -3)  # the window's edges have no neighbours to interpolate from
        mine = np.interp(csv[channel].t[inner] + start, bag[channel].t, bag[channel].values)
        assert np.sqrt(np.nanmean((mine - csv[channel].values[inner]) ** 2)) < 1e-3, channel
    for k in range(1, 7):
        command = bag[f"cmd_{k}"]
        held = command.values[np.searchsorted(command.t, csv[f"cmd_{k}"].t + start + 1e-9, "right") - 1]
        assert np.mean(held == csv[f"cmd_{k}"].values) > 0.995


@pytest.mark.parametrize("name", RUNS)
def test_only_from_the_first_command_to_the_last_counts(pool: Pool, name: str) -> None:
    """What the tables of the same runs were cut to by hand."""
    [bag] = find(pool.folder, f"orig_bags/{name}_*.bag")
    whole, (_, table) = read(bag, BAG), pool.both(name)
    [(start, end)] = free_motion(whole, pool.vehicle).kept
    first = float(whole["cmd_1"].t[0])
    assert start == pytest.approx(first if first - whole["p"].t[0] > 0.5 else whole.start)
    assert end == pytest.approx(first + table.end, abs=0.4)


@pytest.mark.parametrize("name", RUNS)
def test_bag_and_table_teach_the_same_yaw(pool: Pool, name: str) -> None:
    """Within one deviation: inertia, drag and the delay."""
    found = []
    for learning in pool.learn(name):
        total = next(each for each in learning.estimate.sums if each.name == "I_z - N_rdot")
        drag = learning.estimate["N_r"]
        found.append((total.value, total.std, drag.value, drag.std, learning.delay))
    bag, csv = found
    assert abs(bag[0] - csv[0]) < min(bag[1], csv[1])
    assert abs(bag[2] - csv[2]) < min(bag[3], csv[3])
    assert abs(bag[4] - csv[4]) < 0.01
