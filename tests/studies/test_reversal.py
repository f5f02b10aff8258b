"""Commands that are neutral for a time after a reversal, one way and the other."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from towtank import load_vehicle
from towtank.recording import Recording, standard_channel

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from reversal_study import with_pauses


def test_commands_are_neutral_after_a_reversal_for_as_long_as_that_way_asks() -> None:
    thruster = load_vehicle("bluerov_2016").thrusters[0]
    name, rest = f"cmd_{thruster.name}", thruster.curve.rest
    commands = rest + np.array([100.0, 200.0, 0.0, -100.0, -200.0, 100.0, 0.0, 100.0])  # astern at 3 s, ahead at 5 s
    log = Recording({name: standard_channel(name, np.arange(8.0), commands)})
    found = with_pauses(log, [thruster], ahead=0.3, astern=1.5)[name]
    at = [0.5, 1.5, 2.5, 3.0, 4.4, 4.5, 5.0, 5.2, 5.3, 6.5, 7.0]
    held = found.values[np.searchsorted(found.t, at, "right") - 1] - rest
    np.testing.assert_array_equal(held, [100.0, 200.0, 0.0, 0.0, 0.0, -200.0, 0.0, 0.0, 100.0, 0.0, 100.0])
    same = with_pauses(log, [thruster], ahead=0.0, astern=0.0)[name]
    np.testing.assert_array_equal(same.values, commands)
