"""Commands by place are bound to the thrusters of a vehicle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.recording import Recording, bind_thrusters

T = np.arange(5) / 10.0


def record(*thrusters: str) -> Recording:
    columns = {f"cmd_{name}": T + i for i, name in enumerate(thrusters)}
    return Recording.from_table(T, {"u": T, **columns}, source="dive.csv")


def test_by_place_and_by_name() -> None:
    bound = bind_thrusters(record("1", "2"), ["port", "starboard"])
    assert bound.names == ("u", "cmd_port", "cmd_starboard")
    assert bound["cmd_starboard"].values[0] == 1.0
    named = bind_thrusters(record("starboard", "port"), ["port", "starboard"])
    assert named["cmd_starboard"].values[0] == 0.0
    assert named.names == ("u", "cmd_port", "cmd_starboard")
    assert bind_thrusters(bound, ["port", "starboard"]) == bound
    ten = bind_thrusters(record(*map(str, range(1, 12))), [f"t{k}" for k in range(1, 12)])
    assert ten["cmd_t11"].values[0] == 10.0


def test_a_vehicle_that_counts_its_thrusters() -> None:
    assert bind_thrusters(record("1", "2"), ["2", "1"])["cmd_2"].values[0] == 1.0


def test_without_commands_nothing_happens() -> None:
    assert bind_thrusters(record(), ["port"]) == record()


@pytest.mark.parametrize(
    ("found", "thrusters", "message"),
    [
        (["1", "2"], ["port"], r"dive.csv: found commands of 2 thrusters, the vehicle has 1 \(port\)"),
        (["1"], ["port", "starboard"], "found commands of 1 thruster"),
        (["1"], [], r"the vehicle has 0 \(none\)"),
        (["prot"], ["port"], r'no thruster "prot" for "cmd_prot"; did you mean "port"\?; its thrusters: port'),
        (["port"], ["port", "starboard"], "no cmd_starboard; expected a command for each thruster"),
    ],
)
def test_thrusters_that_do_not_fit(found: Sequence[str], thrusters: Sequence[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        bind_thrusters(record(*found), thrusters)
