"""The standard channels: name, unit, frame and meaning. SI; world NED; body FRD (forward, starboard, down)."""

from __future__ import annotations

from typing import NamedTuple

__all__ = [
    "ACCELERATIONS",
    "COMMAND_PREFIX",
    "EULER",
    "LINEAR_VELOCITY",
    "MEASURED",
    "MOTION",
    "POSE",
    "POSITION",
    "QUATERNION",
    "RATES",
    "RELATIVE_VELOCITY",
    "STANDARD",
    "STATES",
    "VELOCITIES",
    "WORLD_VELOCITY",
    "WRENCH",
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
MEASURED = MOTION + RELATIVE_VELOCITY  # the columns of all that sensors measure of the motion
COMMAND_PREFIX = "cmd_"


class Standard(NamedTuple):
    """Unit, frame ("NED", "FRD", "NED-FRD" for an attitude, "" for none) and meaning of a channel."""

    unit: str
    frame: str
    description: str


STANDARD: dict[str, Standard] = {
    "x": Standard("m", "NED", "position north of the body origin"),
    "y": Standard("m", "NED", "position east of the body origin"),
    "z": Standard("m", "NED", "position down (depth) of the body origin"),
    "phi": Standard("rad", "NED-FRD", "roll, Euler zyx"),
    "theta": Standard("rad", "NED-FRD", "pitch, Euler zyx"),
    "psi": Standard("rad", "NED-FRD", "yaw (heading), Euler zyx"),
    "qw": Standard("1", "NED-FRD", "attitude quaternion, body to world, scalar part"),
    "qx": Standard("1", "NED-FRD", "attitude quaternion, body to world, x"),
    "qy": Standard("1", "NED-FRD", "attitude quaternion, body to world, y"),
    "qz": Standard("1", "NED-FRD", "attitude quaternion, body to world, z"),
    "u": Standard("m/s", "FRD", "surge velocity of the body origin over ground"),
    "v": Standard("m/s", "FRD", "sway velocity of the body origin over ground"),
    "w": Standard("m/s", "FRD", "heave velocity of the body origin over ground"),
    "u_w": Standard("m/s", "FRD", "surge velocity of the body origin through the water"),
    "v_w": Standard("m/s", "FRD", "sway velocity of the body origin through the water"),
    "w_w": Standard("m/s", "FRD", "heave velocity of the body origin through the water"),
    "vn": Standard("m/s", "NED", "velocity north of the body origin over ground"),
    "ve": Standard("m/s", "NED", "velocity east of the body origin over ground"),
    "vd": Standard("m/s", "NED", "velocity down of the body origin over ground"),
    "p": Standard("rad/s", "FRD", "roll rate"),
    "q": Standard("rad/s", "FRD", "pitch rate"),
    "r": Standard("rad/s", "FRD", "yaw rate"),
    "ax": Standard("m/s^2", "FRD", "specific force (acceleration less gravity) forward"),
    "ay": Standard("m/s^2", "FRD", "specific force (acceleration less gravity) to starboard"),
    "az": Standard("m/s^2", "FRD", "specific force (acceleration less gravity) down; about -9.8 at rest"),
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
