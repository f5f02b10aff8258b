"""Limits that a user is told of hold to the sample: gaps, rates, spikes, dead sensors, merges, cells of a table."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.readers import read
from towtank.recording import Recording, dead_channels, find_spikes, standard_channel
from towtank.recording.channel import Channel
from towtank.recording.consistency.signals import body_velocity, turning
from towtank.recording.grids.alignment import align
from towtank.recording.grids.stretches import cuts, input_rows, spread
from towtank.recording.grids.timing import find_gaps, gap_limit, interpolation_weights, sampling_rate
from towtank.recording.mapping import load_mapping
from towtank.recording.merging.merge import merge, merges_of
from towtank.recording.noise import noise_level, quantum_of
from towtank.recording.tables.csv import read_slowly

RNG = np.random.default_rng(5)


def test_a_folder_is_no_mapping(tmp_path):
    with pytest.raises(InputError) as said:
        load_mapping(tmp_path)
    assert str(said.value).startswith(f"{tmp_path}: cannot be read as TOML (")


def test_motion_of_two_moments_far_apart_is_refused_with_its_span():
    t = np.concatenate([np.arange(500) / 100.0, 1000.0 + np.arange(5), [5e5]]) + 200.0
    run = Recording({"u": standard_channel("u", t, np.sin(t))})
    with pytest.raises(InputError, match=r"the motion spans 500000 s but is measured for little of it"):
        align(run)


@pytest.mark.parametrize("step, limit", [(0.01, 0.15), (0.05, 0.15), (0.06, 0.18), (1.0, 3.0)])
def test_a_gap_is_longer_than_three_steps_and_than_150_ms(step, limit):
    t = step * np.arange(50)
    assert gap_limit(t) == pytest.approx(limit)
    for pause, found in ((0.99 * limit, []), (1.01 * limit, [24])):
        late = np.where(np.arange(50) > 24, t - step + pause, t)
        assert find_gaps(late).tolist() == found


def test_one_sample_alone_has_a_gap_limit_and_no_rate():
    assert gap_limit(np.array([3.0])) == 0.15
    assert np.isnan(sampling_rate(np.array([3.0])))
    assert sampling_rate(np.array([3.0, 3.5])) == 2.0


def test_a_rate_is_that_of_the_usual_steps_without_pauses():
    t = np.cumsum(np.where(np.arange(400) % 100 == 99, 5.0, 0.02))  # four pauses
    assert sampling_rate(t) == 50.0
    jittered = 0.02 * np.arange(1000) + RNG.uniform(-0.001, 0.001, 1000)
    assert sampling_rate(jittered) == pytest.approx(50.0, rel=2e-3)
    bursts = (0.1 * np.arange(100)[:, None] + 1e-4 * np.arange(5)).ravel()  # 50 Hz, received five at a time
    assert sampling_rate(bursts) == pytest.approx(50.0, rel=0.02)


def test_between_two_samples_lies_a_line_and_a_single_sample_is_known_at_its_time_alone():
    t = np.array([0.0, 0.1, 0.2, 1.0])
    weights = interpolation_weights(t, np.array([-0.01, 0.0, 0.025, 0.1, 0.5, 1.0, 1.01]))
    np.testing.assert_allclose(
        weights.linear(np.array([0.0, 4.0, 8.0, 9.0])), [np.nan, 0.0, 1.0, 4.0, np.nan, 9.0, np.nan]
    )
    alone = interpolation_weights(np.array([5.0]), np.array([4.9, 5.0, 5.1]))
    np.testing.assert_array_equal(alone.linear(np.array([7.0])), [np.nan, 7.0, np.nan])


def test_a_wrong_sample_stands_above_the_line_between_its_neighbours_however_they_are_spaced():
    steps = np.where(np.arange(600) % 2 == 0, 0.01, 0.04)
    t = np.cumsum(steps)
    ramp = 3.0 * t + 1e-3 * RNG.normal(size=t.size)
    assert not find_spikes(t, ramp).size
    for at in (200, 201):
        wrong = ramp.copy()
        wrong[at] += 1.5
        assert find_spikes(t, wrong).tolist() == [at]


def test_up_to_two_samples_of_a_hundred_are_accidents():
    t = np.arange(1000) / 100.0
    x = np.sin(t) + 1e-3 * RNG.normal(size=t.size)
    for count, found in ((20, 20), (21, 0)):
        wrong = x.copy()
        wrong[20 + 45 * np.arange(count)] += 5.0
        assert find_spikes(t, wrong).size == found


def test_a_step_that_stays_is_no_spike_and_one_that_comes_back_by_half_is():
    t = np.arange(400) / 100.0
    noise = 1e-3 * RNG.normal(size=t.size)
    for after, found in ((0.4, [200]), (0.6, [])):
        x = noise.copy()
        x[200] += 1.0
        x[201:] += after
        assert find_spikes(t, x).tolist() == found


@pytest.mark.parametrize("still, dead", [(4.8, ()), (5.2, ("u",))])
def test_a_sensor_is_dead_once_it_has_stood_for_five_seconds(still, dead):
    t = np.arange(0.0, 40.0, 0.02)
    columns = {name: 0.01 * RNG.normal(size=t.size) for name in ("u", "v", "w")}
    columns["u"][t >= 40.0 - still] = columns["u"][np.argmax(t >= 40.0 - still)]
    assert dead_channels(Recording.from_table(t, columns)) == dead


def test_of_a_long_run_a_tenth_must_stand_still():
    t = np.arange(0.0, 200.0, 0.1)
    for still, dead in ((19.0, ()), (21.0, ("v",))):
        columns = {name: 0.01 * RNG.normal(size=t.size) for name in ("u", "v", "w")}
        columns["v"][t >= 200.0 - still] = 0.3
        assert dead_channels(Recording.from_table(t, columns)) == dead


def test_offsets_that_come_and_go_are_counted_sample_by_sample():
    t = np.arange(3000) / 50.0
    x = 0.01 * RNG.normal(size=t.size)
    assert noise_level(t, x).share_of_outliers == 0.0
    for start, length in ((300, 1), (900, 3), (1500, 40)):
        x[start : start + length] += 1.0
    x[2200:2260] += 1.0  # 1.2 s: an offset, not an accident
    found = noise_level(t, x)
    assert found.share_of_outliers * found.samples == pytest.approx(1 + 3 + 40)


@pytest.mark.parametrize("std", [0.003, 0.03, 0.3])
@pytest.mark.parametrize("irregular", [False, True])
def test_white_noise_on_a_motion_is_found_by_its_size(std, irregular):
    t = np.arange(4000) / 50.0
    if irregular:
        t = np.sort(t + RNG.uniform(-0.008, 0.008, t.size))
    found = noise_level(t, 2.0 * np.sin(0.7 * t) + std * RNG.normal(size=t.size))
    assert found.white
    assert found.std == pytest.approx(std, rel=0.08)
    assert found.rate == pytest.approx(50.0, rel=0.03)


def test_less_than_three_values_have_no_noise_and_still_a_rate_and_a_count():
    found = noise_level(np.array([0.0, 0.5]), np.array([1.0, 2.0]))
    assert np.isnan(found.std)
    assert (found.rate, found.samples, found.white, found.dead) == (2.0, 2, False, False)


def test_a_coarse_channel_has_its_step_and_a_fine_one_none():
    t = np.arange(2000) / 50.0
    x = np.sin(0.5 * t) + 0.05 * RNG.normal(size=t.size)
    assert quantum_of(np.diff(np.round(x / 0.02) * 0.02)) == pytest.approx(0.02, rel=1e-6)
    assert quantum_of(np.diff(x)) == 0.0
    assert quantum_of(np.diff(np.zeros(50))) == 0.0


def test_body_velocity_comes_from_the_place_where_no_speed_is_measured():
    t = np.arange(0.0, 20.0, 0.05)
    psi = 0.1 * t
    u, v, w = 0.3 + 0.0 * t, -0.2 + 0.0 * t, 0.1 + 0.0 * t
    north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    columns = {
        **{name: np.cumsum(speed) * 0.05 for name, speed in (("x", north), ("y", east), ("z", w))},
        **dict(zip(("phi", "theta", "psi"), (1e-3 * np.sin(t), 1e-3 * np.cos(t), psi), strict=True)),
    }
    run = Recording.from_table(t, columns)
    edges = np.linspace(2.0, 18.0, 33)
    signals = body_velocity(run)
    for name, speed in (("u", 0.3), ("v", -0.2), ("w", 0.1)):
        np.testing.assert_allclose(signals[name].means(edges), speed, atol=2e-3)
    np.testing.assert_allclose(turning(run)["r"].means(edges), 0.1, atol=1e-6)
    assert body_velocity(run.without("z")) == {}
    measured = run.with_channels([*run.channels.values(), standard_channel("u", t, 9.0 + 1e-4 * np.sin(t))])
    np.testing.assert_allclose(body_velocity(measured)["u"].means(edges), 9.0, rtol=1e-4)


def test_a_long_run_is_cut_into_equal_pieces_that_leave_nothing_out():
    t = np.arange(0.0, 100.0, 0.1)
    pieces = cuts(t, 30.0)
    assert len(pieces) == 3
    assert pieces[0][0] == 0
    assert pieces[-1][1] == t.size
    assert [b for _, b in pieces[:-1]] == [a for a, _ in pieces[1:]]
    assert max(b - a for a, b in pieces) - min(b - a for a, b in pieces) <= 2
    assert cuts(t[:0], 30.0) == []
    assert cuts(t[:2], 30.0) == []
    assert cuts(t[:3], 30.0) == [(0, 3)]


def test_inputs_of_a_stretch_begin_with_the_one_in_force():
    stamps = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    assert input_rows(stamps, 2.5, 3.5, before=1.0) == slice(1, 4)  # 1.0 is in force at 1.5
    assert input_rows(stamps, 2.5, 3.0, before=0.0) == slice(2, 4)
    assert input_rows(stamps, 0.5, 9.0, before=1.0) == slice(0, 5)


class Rows:
    """Rows that can be cut."""

    def __init__(self, t: np.ndarray) -> None:
        self.t = t

    def stretch(self, first: int, last: int) -> Rows:
        return Rows(self.t[first:last])


def test_stretches_that_stand_for_long_runs_are_spread_from_end_to_end():
    short = [Rows(np.arange(0.0, 20.0, 0.05))]
    assert spread(short) is short
    long = Rows(np.arange(0.0, 7200.0, 0.02))
    found = spread([long])
    assert found[0].t[0] == 0.0
    assert found[-1].t[-1] == long.t[-1]
    assert sum(each.t.size for each in found) < 0.5 * long.t.size
    between = np.diff([each.t[0] for each in found])
    assert between.max() < 2.0 * between.min()


def test_a_line_of_a_table_may_begin_with_an_empty_cell_or_be_empty(tmp_path):
    path = tmp_path / "dive.csv"
    path.write_text("u,t,v\n,0,1\n\n  \n2,1,\n3,2,5\n")
    found = read_slowly(path, ("u", "t", "v"), ("t", "u", "v"))
    np.testing.assert_array_equal(found["t"], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(found["u"], [np.nan, 2.0, 3.0])
    np.testing.assert_array_equal(found["v"], [1.0, np.nan, 5.0])


@pytest.mark.parametrize(
    "text, place",
    [
        ("t,u\n0,1\n1,2,3\n", ":3: found 3 cells, expected 2"),
        ("t,u\n0,1\n\n1\n", ":4: found 1 cells, expected 2"),
        ("t,u\n0,1\n1,fast\n2,3\n", ':3:2: found "fast" in column "u"'),
    ],
)
def test_the_line_of_a_fault_is_the_one_an_editor_shows(tmp_path, text, place):
    path = tmp_path / "dive.csv"
    path.write_text(text)
    with pytest.raises(InputError) as said:
        read(path)
    assert str(said.value).startswith(f"{path}{place}")


def two_files() -> tuple[Recording, Recording]:
    """A log with commands, 10 to 40 s, and a camera's table, 5 to 47 s, that know a channel of one name."""
    t, camera = np.arange(10.0, 40.0, 0.05), np.arange(5.0, 47.0, 0.05)
    log = Recording(
        {
            "cmd_1": standard_channel("cmd_1", t, 1500.0 + 100.0 * np.sign(np.sin(t))),
            "r": standard_channel("r", t, 0.1 * np.sin(t)),
            "leak": Channel("leak", t, 0.0 * t),
        },
        "dive.BIN",
        attributes={"vehicle": "rov", "epoch": "a"},
    )
    track = Recording(
        {
            "x": standard_channel("x", camera, 0.1 * camera),
            "leak": Channel("leak", camera, 1.0 + 0.0 * camera),
        },
        "mocap.csv",
        attributes={"vehicle": "body 3"},
    )
    return log, track


def test_what_both_files_call_alike_and_is_no_quantity_is_kept_under_both_names():
    run = merge(*two_files(), offset=0.0)
    assert run["leak"].values.max() == 0.0
    assert run["leak (mocap.csv)"].values.min() == 1.0
    assert run.attributes["vehicle"] == "rov"
    assert run.attributes["vehicle (mocap.csv)"] == "body 3"


def test_seconds_outside_the_commands_are_left_out_and_said():
    run = merge(*two_files(), offset=0.0)
    assert (run["x"].t[0], run["x"].t[-1]) == (pytest.approx(10.0, abs=0.11), pytest.approx(39.9, abs=0.06))
    (note,) = [note for note in run.notes if "left out" in note]
    assert note == "12.0 s of mocap.csv left out, for which dive.BIN tells no inputs"
    assert [each["offset_s"] for each in merges_of(run)] == [0.0]


def test_a_file_merged_twice_is_told_twice():
    log, track = two_files()
    run = merge(merge(log, track, offset=1.0), track, offset=2.0)
    assert [(each["file"], each["offset_s"], each["offset_std_s"]) for each in merges_of(run)] == [
        ("mocap.csv", 1.0, None),
        ("mocap.csv", 2.0, None),
    ]


@pytest.mark.parametrize("offset", [29.9, -36.0])
def test_a_second_in_common_is_enough_and_none_is_refused(offset):
    log, track = two_files()
    assert merge(log, track, offset=offset)["x"].t.size
    with pytest.raises(InputError, match=r"expected some time in common: check --merge's offset"):
        merge(log, track, offset=offset * 1.2)


def test_quaternions_and_angles_tell_the_same_turning():
    t = np.arange(0.0, 20.0, 0.02)
    angles = np.column_stack([0.2 * np.sin(t), 0.1 * np.cos(0.7 * t), 0.3 * t])
    q = quaternions_from_eulers(angles)
    by_angles = Recording.from_table(t, dict(zip(("phi", "theta", "psi"), angles.T, strict=True)))
    by_quaternion = Recording.from_table(t, dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True)))
    edges = np.linspace(1.0, 19.0, 60)
    for name in "pqr":
        np.testing.assert_allclose(
            turning(by_angles)[name].means(edges), turning(by_quaternion)[name].means(edges), atol=1e-4
        )
