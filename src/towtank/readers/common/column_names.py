"""What the name of a column suggests: which channel it may be, and the unit that the name bears."""

from __future__ import annotations

import re
from typing import NamedTuple

from towtank.recording.standard import is_command, is_standard

__all__ = ["TIME", "Suggestion", "suggestion"]

TIME = "time"
_DEGREE = 0.017453292519943295
_G = 9.80665
_ANGLE = {"rad": 1.0, "deg": _DEGREE, "degree": _DEGREE, "degrees": _DEGREE, "cdeg": 0.01 * _DEGREE, "mrad": 1e-3}
_RATE = {**_ANGLE, "rads": 1.0, "dps": _DEGREE, "degs": _DEGREE, "mrads": 1e-3, "rad_s": 1.0, "deg_s": _DEGREE}
_LENGTH = {"m": 1.0, "cm": 0.01, "mm": 1e-3}
_SPEED = {"mps": 1.0, "ms": 1.0, "m_s": 1.0, "mms": 1e-3, "cms": 0.01, "kn": 0.514444, "knots": 0.514444}
_FORCE = {"n": 1.0, "newton": 1.0, "nm": 1.0, "kgf": _G}
_UNITS: dict[str, dict[str, float]] = {
    TIME: {"s": 1.0, "sec": 1.0, "secs": 1.0, "ms": 1e-3, "us": 1e-6, "usec": 1e-6, "ns": 1e-9, "nsec": 1e-9},
    "attitude": _ANGLE,
    "rates": _RATE,
    "position": _LENGTH,
    "velocity": _SPEED,
    "world velocity": _SPEED,
    "specific force": {"ms2": 1.0, "mps2": 1.0, "m_s2": 1.0, "g": _G, "mg": 1e-3 * _G},
    "force": _FORCE,
    "moment": _FORCE,
    "voltage": {"v": 1.0, "mv": 1e-3},
    "thruster": {},
}
_OTHER = re.compile(
    r"(?:^|_)(?:des|desired|target|tgt|ref|reference|set|setpoint|var|cov|std|err|error|bias|offset|ofs|rc_?in|mag"
    r"|vibe?|vibration|nav)(?:_|$)"
)


_OWN = ("towtank", "MATLAB")  # tables whose columns may bear standard names
_NO_MEASUREMENT = ("MANUAL_CONTROL", "SIM", "HEARTBEAT", "RC_", "HOME_", "MISSION_", "SET_", "POSITION_TARGET")
_THOUSANDTHS = {"rates": 1e-3, "specific force": 1e-3 * _G}


class Suggestion(NamedTuple):
    """What a column may be.

    Attributes:
        quantity: "rates", "thruster", ...; columns of one quantity and one `family` belong together. channel: its name;
            of a thruster its number. rank: 0 for the likeliest kind of name. unit: that the name bears, "" where none.
        scale: channel = scale * column, by that unit.
    """

    quantity: str
    channel: str
    family: str
    rank: int
    unit: str
    scale: float


class _Rule(NamedTuple):
    quantity: str
    pattern: re.Pattern[str]
    axes: dict[str, str]
    scale: float = 1.0


def _rule(quantity: str, pattern: str, axes: str, channels: str, scale: float = 1.0) -> _Rule:
    return _Rule(quantity, re.compile(pattern), dict(zip(axes.split(), channels.split(), strict=True)), scale)


_RULES = (
    _rule(TIME, r"(?P<family>(?:.*_)?)(?P<axis>t|time|timestamp|stamp|elapsed|seconds|secs|clock)$",
          "t time timestamp stamp elapsed seconds secs clock", "t t t t t t t t"),
    _rule("rates", r"(?P<family>.*(?:gyro?|omega|angular_velocity|ang_?vel|angular|rates?)_?)(?P<axis>[xyz])$",
          "x y z", "p q r"),
    _rule("rates", r"(?P<family>.*(?:gyro?|rates?|omega)_?)(?P<axis>[pqr])$", "p q r", "p q r"),
    _rule("rates", r"(?P<family>)(?P<axis>[xyz])_?gyro?$", "x y z", "p q r"),
    _rule("rates", r"(?P<family>(?:.*_)?)(?P<axis>roll|pitch|yaw|heading)_?(?:rate|speed|vel|velocity)$",
          "roll pitch yaw heading", "p q r r"),
    _rule("rates", r"(?P<family>(?:.*_)?)(?P<axis>[pqr])$", "p q r", "p q r"),
    _rule("specific force", r"(?P<family>.*(?:acc|accel|acceleration|specific_force)_?)(?P<axis>[xyz])$",
          "x y z", "ax ay az"),
    _rule("specific force", r"(?P<family>)(?P<axis>[xyz])_?acc(?:el)?$", "x y z", "ax ay az"),
    _rule("specific force", r"(?P<family>(?:.*_)?)a_?(?P<axis>[xyz])$", "x y z", "ax ay az"),
    _rule("attitude", r"(?P<family>.*(?:quat(?:ernion)?|orientation|rot(?:ation)?|(?:^|_)q)_?)(?P<axis>[wxyz])$",
          "w x y z", "qw qx qy qz"),
    _rule("attitude", r"(?P<family>(?:.*_)?)(?P<axis>roll|pitch|yaw|phi|theta|psi|heading|hdg)$",
          "roll pitch yaw phi theta psi heading hdg", "phi theta psi phi theta psi psi psi"),
    _rule("world velocity", r"(?P<family>(?:.*_)?(?:v|vel|velocity|speed)_?)(?P<axis>n|e|d|north|east|down)$",
          "n e d north east down", "vn ve vd vn ve vd"),
    _rule("velocity", r"(?P<family>.*(?:vel|velocity|linear|twist|dvl|speed|(?:^|_)v)_?)(?P<axis>[xyz])$",
          "x y z", "u v w"),
    _rule("velocity", r"(?P<family>(?:.*_)?)(?P<axis>surge|sway|heave)(?:_?(?:speed|vel|velocity))?$",
          "surge sway heave", "u v w"),
    _rule("velocity", r"(?P<family>(?:.*_)?)(?P<axis>[uvw])$", "u v w", "u v w"),
    _rule("force", r"(?P<family>.*(?:force|tau|(?:^|_)f)_?)(?P<axis>[xyz])$", "x y z", "X Y Z"),
    _rule("moment", r"(?P<family>.*(?:torque|moment)_?)(?P<axis>[xyz])$", "x y z", "K M N"),
    _rule("position", r"(?P<family>.*(?:pos|position|translation|trans|(?:^|_)p)_?)(?P<axis>[xyzned]|north|east|down)$",
          "x y z n e d north east down", "x y z x y z x y z"),
    _rule("position", r"(?P<family>(?:.*_)?)(?P<axis>x|y|z|north|east|down)$",
          "x y z north east down", "x y z x y z"),
    _rule("position", r"(?P<family>(?:.*_)?)(?P<axis>depth)$", "depth", "z"),
    _rule("position", r"(?P<family>(?:.*_)?)(?P<axis>altitude|height)$", "altitude height", "z z", -1.0),
    _rule("voltage", r"(?P<family>(?:.*_)?)(?P<axis>volt|voltage|vbat|vbatt|v_bat)$",
          "volt voltage vbat vbatt v_bat", "voltage voltage voltage voltage voltage"),
    _rule("voltage", r"(?P<family>(?:.*_)?)(?P<axis>bat|batt|battery|supply|bus)$",
          "bat batt battery supply bus", "voltage voltage voltage voltage voltage"),
)  # fmt: skip
_THRUSTER = re.compile(
    r"(?P<family>(?:.*_)?(?:pwm|cmd|command|thr|thruster|motor|mot|esc|servo|output|out|throttle|rcou_c|rco2_c|rco3_c)"
    r"s?(?:_(?:data|values?|commands?|inputs?))*_?)"
    r"(?P<axis>\d+|left|right|port|starboard|stbd)(?:_?(?:raw|pwm|cmd|out))?$"
)
_SIDES = {"left": "1", "port": "1", "right": "2", "starboard": "2", "stbd": "2"}


def suggestion(path: str, table: str = "", kind: str = "") -> Suggestion | None:
    """Return what a column may be by its name, None where the name says nothing.

    Args:
        path: of the column, as "gyro_x", "GyrX" or "twist.linear.x".
        table, kind: that holds it, and the type of its messages, in a log of messages.

    >>> suggestion("yaw_deg")[:2], suggestion("GyrX")[:2], suggestion("desired_yaw")
    (('attitude', 'psi'), ('rates', 'p'), None)
    """
    if is_standard(path) and (not table or kind in _OWN):
        return Suggestion("thruster" if is_command(path) else "standard", path, "", -1, "", 1.0)
    name = _plain(path)
    if _OTHER.search(name) or (kind == "MAVLink" and table.startswith(_NO_MEASUREMENT)):
        return None
    found = _by_rules(name, table)
    return found if found is None else _of_message(found, table, kind)


def _by_rules(name: str, table: str) -> Suggestion | None:
    for base, unit in _bases(name):
        of_thruster = _THRUSTER.match(f"{_plain(table)}_{base}" if table else base)
        if of_thruster and not unit:
            number = _SIDES.get(of_thruster["axis"], of_thruster["axis"])
            return Suggestion("thruster", number, of_thruster["family"], 0, "", 1.0)
        for rank, rule in enumerate(_RULES):
            match = rule.pattern.match(base)
            known = unit in _UNITS[rule.quantity] or not (unit or rule is _RULES[-1])  # of a battery volts alone
            if match and known:
                scale = rule.scale * _UNITS[rule.quantity].get(unit, 1.0)
                return Suggestion(rule.quantity, rule.axes[match["axis"]], match["family"], rank, unit, scale)
    return None


def _of_message(found: Suggestion, table: str, kind: str) -> Suggestion:
    """Return what a field of an autopilot's messages may be, whose units and frames are known."""
    if kind == "DataFlash" and found.quantity == "attitude" and not found.channel.startswith("q"):
        return found._replace(unit="deg", scale=_DEGREE)
    if kind != "MAVLink":
        return found
    if found.quantity == "velocity":
        scale = 0.01 if table.startswith("GLOBAL_POSITION_INT") else 1.0
        channel = dict(zip("uvw", ("vn", "ve", "vd"), strict=True))[found.channel]
        return found._replace(
            quantity="world velocity", channel=channel, unit="m_s" if scale == 1.0 else "cms", scale=scale
        )
    if table.startswith(("RAW_IMU", "SCALED_IMU")) and found.quantity in ("rates", "specific force"):
        return found._replace(unit="mrad" if found.quantity == "rates" else "mg", scale=_THOUSANDTHS[found.quantity])
    return found


def _plain(path: str) -> str:
    """Return a name in lower case with underscores between its words: GyrX and twist.linear[0] alike."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", path)
    return re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")


def _bases(name: str) -> list[tuple[str, str]]:
    """Return a name without the unit at its end, and that unit; then as it is."""
    out = []
    for count in (2, 1):
        words = name.split("_")
        unit = "_".join(words[-count:])
        if len(words) > count and any(unit in units for units in _UNITS.values()):
            out.append(("_".join(words[:-count]), unit))
    return [*out, (name, "")]
