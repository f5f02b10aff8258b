"""Commands by their place in a mapping bound to the thrusters of a vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from towtank.errors import InputError, nearest
from towtank.recording.recording import Recording
from towtank.recording.standard import COMMAND_PREFIX, is_command

__all__ = ["bind_thrusters"]


def bind_thrusters(recording: Recording, thrusters: Sequence[str]) -> Recording:
    """Return the recording with one command channel `cmd_<thruster>` for each thruster, in the vehicle's
    order.

    Commands cmd_1 .. cmd_n, as a mapping's `thrusters = [...]` gives them, are renamed in order; commands
    that bear the vehicle's names stay. A recording without commands (of wrenches) is returned as it is.

    Raises:
        InputError: the recording has more, fewer or other thrusters than the vehicle.
    """
    found = [name.removeprefix(COMMAND_PREFIX) for name in recording.names if is_command(name)]
    if not found:
        return recording
    prefix = f"{recording.source}: " if recording.source else ""
    if set(found) == set(thrusters):
        names = {name: name for name in thrusters}
    elif set(found) == {str(k) for k in range(1, len(found) + 1)}:
        if len(found) != len(thrusters):
            many = "thruster" if len(found) == 1 else "thrusters"
            raise InputError(
                f"{prefix}found commands of {len(found)} {many}, the vehicle has {len(thrusters)} "
                f"({', '.join(thrusters) or 'none'})"
            )
        names = {str(k): name for k, name in enumerate(thrusters, 1)}
    else:
        _refuse(prefix, found, thrusters)
    bound = [recording[COMMAND_PREFIX + old].renamed(COMMAND_PREFIX + new) for old, new in names.items()]
    rest = [channel for name, channel in recording.channels.items() if not is_command(name)]
    return recording.with_channels([*rest, *bound])


def _refuse(prefix: str, found: Sequence[str], thrusters: Sequence[str]) -> NoReturn:
    known = ", ".join(thrusters) or "none"
    for name in found:
        if name not in thrusters:
            raise InputError(
                f'{prefix}the vehicle has no thruster "{name}" for "{COMMAND_PREFIX}{name}"'
                f"{nearest(name, thrusters)}; its thrusters: {known}"
            )
    missing = [COMMAND_PREFIX + name for name in thrusters if name not in found]
    raise InputError(f"{prefix}no {', '.join(missing)}; expected a command for each thruster of the vehicle ({known})")
