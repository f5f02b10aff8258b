"""Commands by number bound to the thrusters of the vehicle, sample by sample."""

from __future__ import annotations

from dataclasses import replace

from towtank.live.source import Sample
from towtank.recording.standard import COMMAND_PREFIX, is_command, is_standard
from towtank.vehicle import Vehicle

__all__ = ["CommandNames"]

_MOST, _LONGEST = 20, 60  # names that are told, and their characters


class CommandNames:
    """Renames cmd_1, cmd_2, ... in the order of the vehicle's thrusters; commands by name stay.

    Attributes:
        foreign: channels that are none of the vehicle's, or not standard ones: they are passed over.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        own = [each.name for each in vehicle.thrusters]
        self._known = {f"{COMMAND_PREFIX}{k}": f"{COMMAND_PREFIX}{name}" for k, name in enumerate(own, 1)}
        self._known |= {f"{COMMAND_PREFIX}{name}": f"{COMMAND_PREFIX}{name}" for name in own}
        self._any = not own
        self._bound: dict[tuple[str, ...], tuple[str, ...]] = {}  # names -> the vehicle's, "" where passed over
        self.foreign: dict[str, None] = {}

    def bound(self, sample: Sample) -> Sample:
        """Return the sample with the vehicle's names."""
        names = self._bound.get(sample.names)
        if names is None:
            names = tuple(self._own(name) for name in sample.names)
            if len(self._bound) < 1000:
                self._bound[sample.names] = names
        if names == sample.names:
            return sample
        kept = [(name, value) for name, value in zip(names, sample.values, strict=True) if name]
        return replace(sample, names=tuple(name for name, _ in kept), values=tuple(value for _, value in kept))

    def _own(self, name: str) -> str:
        found = self._known.get(name, "") if is_command(name) and not self._any else name if is_standard(name) else ""
        if not found and len(self.foreign) < _MOST:
            self.foreign.setdefault(ascii(name[:_LONGEST])[1:-1])  # it will stand on a terminal
        return found
