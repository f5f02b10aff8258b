"""Which sources of a ROS recording are no measurement, judged by the whole log."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import joined
from towtank.errors import InputError
from towtank.readers.common.sources import Source
from towtank.readers.common.tables import Table
from towtank.recording.columns import assemble
from towtank.recording.consistency.rates import rate_scales
from towtank.recording.standard import QUANTITIES

__all__ = ["judged"]

_MINIMUM = 4  # samples from which anything is judged
_MOTION = tuple(each.name for each in QUANTITIES)
_SURFACE = -6.0  # m: a depth above the air of the highest lakes; what was read is no absolute pressure
_UNSURE = 0.5  # m/s: a velocity that says of itself that it is worse is none
_AIDS = re.compile(r"dvl|vision_pose|vision_speed|odometry/out|mocap|vrpn|qualisys|optitrack|vicon|usbl|optical_flow")
_OTHER_UNIT = math.log(2.5)  # of the logarithm of a rate's scale, from which it is no radians


def judged(sources: Sequence[Source], tables: Mapping[str, Table]) -> list[Source]:
    """Return the sources, those refused that cannot be used, and of an autopilot's outputs those that move."""
    aided = any(_AIDS.search(name.lower()) for name in tables)
    done: list[Source] = []
    for source in sources:
        table = tables[source.table]
        why = source.refused or _still(source) or _unsure(source, table, aided=aided) or _out_of_reach(source)
        judgement = replace(source, refused=why)
        done.append(_moving(judgement, table) if source.quantity == "commands" else judgement)
    return [_checked_by_itself(source, done) for source in done]


def _still(source: Source) -> str:
    """Return why a reading that never changes is none: a message has to fill in its fields with something."""
    if source.quantity not in _MOTION or source.samples < _MINIMUM:
        return ""
    measured = [values[np.isfinite(values)] for values in source.channels.values()]
    if all(each.size == 0 or each.min() == each.max() for each in measured):
        return "it never changes: the field is filled in, not measured"
    return ""


def _unsure(source: Source, table: Table, *, aided: bool) -> str:
    """Return why a velocity, or a position summed up from it, is not aided by a measurement of one."""
    if source.quantity not in ("velocity", "position"):
        return ""
    if re.search(r"mavros/(local_position|global_position)", table.name.lower()) and not aided:
        return (
            "the autopilot's filter, and nothing in the recording aids its velocity (no DVL, no tracking): "
            "dead reckoning is no measurement"
        )
    path = "twist.covariance[0]"
    if source.quantity == "velocity" and path in table:
        variance = _median(table[path])
        if variance > _UNSURE**2:
            return f"its own covariance says ± {np.sqrt(variance):.2g} m/s: nothing aids it"
    return ""


def _out_of_reach(source: Source) -> str:
    """Return why a depth by pressure is none."""
    if source.quantity != "depth" or "pressure" not in source.note or source.samples < _MINIMUM:
        return ""
    if _median(source.channels["z"]) < _SURFACE:
        return (
            "no absolute pressure in Pa, it is less than that of air; map it: "
            f'z = {{ from = "{source.table}.fluid_pressure", scale = ..., offset = ... }}'
        )
    return ""


def _median(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else 0.0


def _moving(source: Source, table: Table) -> Source:
    """Return, of an autopilot's outputs, those that move, numbered in order."""
    if table.kind != "mavros_msgs/msg/RCOut":
        return source
    moving = {
        name: values
        for name, values in source.channels.items()
        if (known := values[np.isfinite(values)]).size and known.min() < known.max()
    }
    if not moving:
        return replace(source, refused="no output moves")
    taken = ", ".join(name.removeprefix("cmd_") for name in moving)
    note = f"{table.name}: the recording does not say which output drives what; outputs {taken}, which move, are taken "
    channels = {f"cmd_{k}": values for k, values in enumerate(moving.values(), 1)}
    return replace(source, channels=channels, note=note + "as thrusters in their order")


def _checked_by_itself(source: Source, sources: Sequence[Source]) -> Source:
    """Return an inertial unit's reading, refused where it contradicts its own gravity or its own attitude."""
    if source.quantity not in ("attitude", "rates", "specific force") or source.refused:
        return source
    mine = {each.quantity: each for each in sources if each.table == source.table}
    force = mine.get("specific force")
    if force is not None and not force.refused and _median(force.channels["az"]) > 5.0:
        return replace(source, refused="gravity points up in it: its axes are others than its frame says; map it")
    if source.quantity == "rates" and "attitude" in mine and not mine["attitude"].refused:
        return replace(source, refused=_of_no_unit(source, mine["attitude"]))
    return source


def _of_no_unit(rates: Source, attitude: Source) -> str:
    """Return why rates are none: another multiple of their own attitude's than a unit's, which is mended later."""
    try:
        both = assemble(rates.t, {**rates.channels, **attitude.channels}, place=rates.table, source=rates.table)
    except InputError:
        return ""  # reading it says why
    wrong = [each for each in rate_scales(both) if each.off == 1.0 and abs(math.log(abs(each.scale))) > _OTHER_UNIT]
    if not wrong:
        return ""
    return (
        f"{joined([each.text for each in wrong])} times the rates of its own attitude, neither radians nor degrees per "
        'second (57.3 times); map it with its scale: p = { from = "...", scale = ... }'
    )
