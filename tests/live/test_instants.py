"""From names and values to what the learner takes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from towtank import load_vehicle
from towtank.core.attitude import quaternion_from_euler
from towtank.live.links.source import Sample
from towtank.live.pipeline.instants import Instants
from towtank.live.pipeline.sorter import Arrival, Preference
from towtank.live.session import CommandNames
from towtank.vehicle import Vehicle


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("seamor")


def test_measurements_stand_in_their_places(vehicle: Vehicle) -> None:
    found = Instants(vehicle).arguments({"z": 2.0, "psi": 0.5, "r": 0.1, "az": -9.8, "x": math.nan})
    assert found.keys() == {"pose", "velocity", "acceleration"}
    assert np.array_equal(found["pose"], [np.nan, np.nan, 2.0, np.nan, np.nan, 0.5], equal_nan=True)
    assert np.array_equal(found["velocity"], [np.nan] * 5 + [0.1], equal_nan=True)
    assert np.array_equal(found["acceleration"], [np.nan, np.nan, -9.8], equal_nan=True)


def test_commands_hold_thruster_by_thruster(vehicle: Vehicle) -> None:
    names = [f"cmd_{each.name}" for each in vehicle.thrusters]
    instants = Instants(vehicle)
    assert instants.arguments({names[0]: 1.0}) == {}  # the others have not been heard of
    found = instants.arguments({name: float(k) for k, name in enumerate(names)} | {"voltage": 15.0})
    assert found["voltage"] == 15.0
    assert np.array_equal(found["commands"], np.arange(float(len(names))))
    found = instants.arguments({names[2]: 9.0})
    assert found["commands"][[1, 2]] == pytest.approx([1.0, 9.0])
    assert "commands" not in instants.arguments({"x": 1.0})
    instants.forget()
    assert instants.arguments({names[2]: 9.0}) == {}


def test_inputs_go_on_where_they_are_told_and_are_the_same(vehicle: Vehicle) -> None:
    same = {f"cmd_{each.name}": float(k) for k, each in enumerate(vehicle.thrusters)}
    other = next(iter(same))
    instants = Instants(vehicle)
    assert not instants.goes_on(same)  # none was known
    instants.arguments(same)
    assert instants.goes_on({"x": 1.0, **same})
    assert instants.goes_on({other: 0.0})
    assert not instants.goes_on({"x": 1.0})  # nothing is told of them
    assert not instants.goes_on({**same, other: 9.0})
    pushed = Instants(vehicle)
    pushed.arguments({"X": 5.0})
    assert pushed.goes_on({"X": 5.0})
    assert not pushed.goes_on({"X": 6.0})


def test_a_wrench_counts_where_no_commands_come(vehicle: Vehicle) -> None:
    instants = Instants(vehicle)
    assert np.array_equal(instants.arguments({"X": 5.0})["wrench"], [5.0] + [np.nan] * 5, equal_nan=True)
    instants.arguments({f"cmd_{each.name}": 0.0 for each in vehicle.thrusters})
    assert instants.arguments({"X": 5.0}) == {}


def test_quaternions_and_velocities_in_the_world_are_turned(vehicle: Vehicle) -> None:
    instants = Instants(vehicle)
    assert instants.arguments({"vn": 1.0, "ve": 0.0, "vd": 0.0}) == {}  # not known which way it faces
    q = quaternion_from_euler(0.0, 0.0, math.pi / 2.0)
    pose = instants.arguments(dict(zip(("qw", "qx", "qy", "qz"), q, strict=True)))["pose"]
    assert pose[3:] == pytest.approx([0.0, 0.0, math.pi / 2.0])
    velocity = instants.arguments({"vn": 1.0, "ve": 0.0, "vd": 0.5})["velocity"]
    assert velocity[:3] == pytest.approx([0.0, -1.0, 0.5])


def test_commands_by_number_get_the_vehicles_names(vehicle: Vehicle) -> None:
    names = CommandNames(vehicle)
    bound = names.bound(Sample("a", "b", 0.0, 0.0, ("cmd_2", "x", "cmd_99", "cmd_\x1bodd"), (1.0, 2.0, 3.0, 4.0)))
    assert bound.names == (f"cmd_{vehicle.thrusters[1].name}", "x")
    assert bound.values == (1.0, 2.0)
    assert list(names.foreign) == ["cmd_99", "cmd_\\x1bodd"]


def test_of_two_links_the_one_named_first_is_learned_from_while_it_sends() -> None:
    def sample(t: float, rank: int) -> Arrival:
        return Arrival(t, t, rank, Sample("a", "b", t, t, ("x",), (float(rank),)))

    preference = Preference()
    assert preference.taken(sample(0.0, 1)) == {"x": 1.0}
    assert preference.taken(sample(0.1, 0)) == {"x": 0.0}
    assert preference.taken(sample(0.2, 1)) == {}
    assert preference.taken(sample(1.0, 1)) == {}
    assert preference.taken(sample(1.2, 1)) == {"x": 1.0}  # the first one has been silent for a second
    assert list(preference.doubled) == ["x"]


def test_an_attitude_has_one_source_whatever_its_numbers_are_called() -> None:
    """A tracker tells a quaternion, an autopilot angles: of two norths in turn nothing can be learned."""

    def sample(t: float, rank: int) -> Arrival:
        names, values = [(("phi", "theta", "psi"), (0.0, 0.0, 1.2)), (("qw", "qx", "qy", "qz"), (1.0, 0.0, 0.0, 0.0))][
            rank
        ]
        return Arrival(t, t, rank, Sample("a", "b", t, t, names, values))

    preference = Preference()
    assert set(preference.taken(sample(0.0, 1))) == {"qw", "qx", "qy", "qz"}
    assert set(preference.taken(sample(0.1, 0))) == {"phi", "theta", "psi"}
    assert preference.taken(sample(0.2, 1)) == {}
    assert set(preference.taken(sample(1.3, 1))) == {"qw", "qx", "qy", "qz"}  # the first one is silent
    assert set(preference.doubled) == {"qw", "qx", "qy", "qz"}


def test_inputs_in_force_are_those_that_are_whole(vehicle: Vehicle) -> None:
    instants = Instants(vehicle)
    assert instants.in_force() == {}
    names = [f"cmd_{each.name}" for each in vehicle.thrusters]
    instants.arguments({"X": 5.0})
    assert instants.in_force()["wrench"][0] == 5.0
    instants.arguments({names[0]: 1.0})
    assert instants.in_force() == {}  # some of the commands: a wrench beside them is their consequence
    instants.arguments(dict.fromkeys(names, 2.0))
    assert instants.in_force().keys() == {"commands"}
    instants.arguments({"voltage": 15.0})
    assert instants.in_force()["voltage"] == 15.0
