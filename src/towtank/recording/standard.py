"""The standard channels: name, unit, frame and meaning; and what sensors measure with them, one row each.

SI; world NED; body FRD (forward, starboard, down).
"""

from __future__ import annotations

from typing import Literal, NamedTuple

__all__ = [
    "ACCELERATIONS",
    "COMMAND_PREFIX",
    "EULER",
    "FURTHER",
    "LINEAR_VELOCITY",
    "MEASURED",
    "MOTION",
    "POSE",
    "POSITION",
    "QUANTITIES",
    "QUATERNION",
    "RATES",
    "RELATIVE_VELOCITY",
    "SAMPLE",
    "STANDARD",
    "STATES",
    "TRIPLES",
    "VELOCITIES",
    "WORLD_VELOCITY",
    "WRENCH",
    "Quantity",
    "QuantityName",
    "Standard",
    "is_command",
    "is_held",
    "is_input",
    "is_standard",
    "standard_of",
]

POSITION = ("x", "y", "z")
EULER = ("phi", "theta", "psi")
QUATERNION = ("qw", "qx", "qy", "qz")
POSE = POSITION + EULER
LINEAR_VELOCITY = ("u", "v", "w")
RATES = ("p", "q", "r")
VELOCITIES = LINEAR_VELOCITY + RATES
RELATIVE_VELOCITY = ("u_w", "v_w", "w_w")
WORLD_VELOCITY = ("vn", "ve", "vd")
ACCELERATIONS = ("ax", "ay", "az")
WRENCH = ("X", "Y", "Z", "K", "M", "N")
MOTION = POSE + VELOCITIES + ACCELERATIONS
COMMAND_PREFIX = "cmd_"

QuantityName = Literal[
    "position", "depth", "attitude", "velocity", "rates", "specific force", "velocity through the water"
]


class Quantity(NamedTuple):
    """What one sensor measures of the motion.

    Attributes:
        channels: its own. argument: of `Learner.update` that carries them. noise: usual deviation, in their unit.
        instead: channels that may stand for them.
        swept: whether it is a speed of the place of the sensor, which the rates sweep along.
    """

    name: QuantityName
    channels: tuple[str, ...]
    argument: str
    noise: float
    instead: tuple[str, ...] = ()
    swept: bool = False


QUANTITIES = (  # a new one goes to the end: columns keep their places
    Quantity("position", ("x", "y"), "pose", 2e-3),
    Quantity("depth", ("z",), "pose", 2e-3),
    Quantity("attitude", EULER, "pose", 2e-3, instead=QUATERNION),
    Quantity("velocity", LINEAR_VELOCITY, "velocity", 1e-2, instead=WORLD_VELOCITY, swept=True),
    Quantity("rates", RATES, "velocity", 3e-3),
    Quantity("specific force", ACCELERATIONS, "acceleration", 5e-2),
    Quantity("velocity through the water", RELATIVE_VELOCITY, "water_velocity", 1e-2, swept=True),
)
MEASURED = tuple(name for each in QUANTITIES for name in each.channels)  # columns of a row of measurements
FURTHER = MEASURED[len(MOTION) :]
TRIPLES = tuple(MEASURED[k : k + 3] for k in range(0, len(MEASURED), 3))  # the same sensor by sensor, three of each
SAMPLE = {  # argument of `Learner.update` -> channels of its numbers
    argument: tuple(name for each in QUANTITIES if each.argument == argument for name in each.channels)
    for argument in dict.fromkeys(each.argument for each in QUANTITIES)
}


class Standard(NamedTuple):
    """Unit, frame ("NED", "FRD", "NED-FRD" for an attitude, "" for none) and meaning of a channel.

    Attributes:
        axis: whose motion it shows ("surge" .. "yaw"), "" for none. shows: what of it, in words.
    """

    unit: str
    frame: str
    description: str
    axis: str = ""
    shows: str = ""


STANDARD: dict[str, Standard] = {
    "x": Standard("m", "NED", "position north of the body origin", "surge", "position"),
    "y": Standard("m", "NED", "position east of the body origin", "sway", "position"),
    "z": Standard("m", "NED", "position down (depth) of the body origin", "heave", "depth"),
    "phi": Standard("rad", "NED-FRD", "roll, Euler zyx", "roll", "roll angle"),
    "theta": Standard("rad", "NED-FRD", "pitch, Euler zyx", "pitch", "pitch angle"),
    "psi": Standard("rad", "NED-FRD", "yaw (heading), Euler zyx", "yaw", "heading"),
    "qw": Standard("1", "NED-FRD", "attitude quaternion, body to world, scalar part"),
    "qx": Standard("1", "NED-FRD", "attitude quaternion, body to world, x"),
    "qy": Standard("1", "NED-FRD", "attitude quaternion, body to world, y"),
    "qz": Standard("1", "NED-FRD", "attitude quaternion, body to world, z"),
    "u": Standard("m/s", "FRD", "surge velocity of the body origin over ground", "surge", "speed"),
    "v": Standard("m/s", "FRD", "sway velocity of the body origin over ground", "sway", "speed"),
    "w": Standard("m/s", "FRD", "heave velocity of the body origin over ground", "heave", "speed"),
    "u_w": Standard(
        "m/s", "FRD", "surge velocity of the body origin through the water", "surge", "speed through the water"
    ),
    "v_w": Standard(
        "m/s", "FRD", "sway velocity of the body origin through the water", "sway", "speed through the water"
    ),
    "w_w": Standard(
        "m/s", "FRD", "heave velocity of the body origin through the water", "heave", "speed through the water"
    ),
    "vn": Standard("m/s", "NED", "velocity north of the body origin over ground"),
    "ve": Standard("m/s", "NED", "velocity east of the body origin over ground"),
    "vd": Standard("m/s", "NED", "velocity down of the body origin over ground"),
    "p": Standard("rad/s", "FRD", "roll rate", "roll", "rate"),
    "q": Standard("rad/s", "FRD", "pitch rate", "pitch", "rate"),
    "r": Standard("rad/s", "FRD", "yaw rate", "yaw", "rate"),
    "ax": Standard("m/s^2", "FRD", "specific force (acceleration less gravity) forward", "surge", "acceleration"),
    "ay": Standard("m/s^2", "FRD", "specific force (acceleration less gravity) to starboard", "sway", "acceleration"),
    "az": Standard(
        "m/s^2", "FRD", "specific force (acceleration less gravity) down; about -9.8 at rest", "heave", "acceleration"
    ),
    "X": Standard("N", "FRD", "force of the thrusters forward"),
    "Y": Standard("N", "FRD", "force of the thrusters to starboard"),
    "Z": Standard("N", "FRD", "force of the thrusters down"),
    "K": Standard("N m", "FRD", "moment of the thrusters about body x (roll)"),
    "M": Standard("N m", "FRD", "moment of the thrusters about body y (pitch)"),
    "N": Standard("N m", "FRD", "moment of the thrusters about body z (yaw)"),
    "voltage": Standard("V", "", "supply voltage of the thrusters"),
}


# What an autopilot says of itself: no measurement, but it tells what of the rest counts (`free_motion`).
STATES: dict[str, Standard] = {
    "armed": Standard("1", "", "1 while the autopilot lets the thrusters turn, 0 while it does not"),
    "mode": Standard("1", "", 'number of the autopilot\'s mode; the attribute "modes" has the names'),
    "bottomed": Standard("1", "", "1 while the autopilot takes the vehicle to stand on the bottom"),
}

_COMMAND = Standard("command", "", "command of a thruster, in the unit of its curve")


def is_command(name: str) -> bool:
    """True for `cmd_<thruster>`."""
    return name.startswith(COMMAND_PREFIX) and len(name) > len(COMMAND_PREFIX)


def is_input(name: str) -> bool:
    """True for the inputs of a vehicle: commands and wrench."""
    return name in WRENCH or is_command(name)


def is_held(name: str) -> bool:
    """True for the inputs of a vehicle and the states of its autopilot: each value holds until the next one comes."""
    return is_input(name) or name in STATES


def is_standard(name: str) -> bool:
    """True for the names of `STANDARD` and for `cmd_<thruster>`."""
    return name in STANDARD or is_command(name)


def standard_of(name: str) -> Standard:
    """Return unit, frame and meaning of a standard channel, or of a state. Raises `KeyError` for any other name."""
    return _COMMAND if is_command(name) else STATES[name] if name in STATES else STANDARD[name]
