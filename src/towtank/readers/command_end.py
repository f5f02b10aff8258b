"""Commands that fall silent before the motion ends: held for ever, or has the vehicle been switched off?"""

from __future__ import annotations

import numpy as np

from towtank.recording.recording import Recording
from towtank.recording.standard import is_held

__all__ = ["with_command_end"]

_PAUSE, _INTERVALS = 2.0, 10.0  # s, and usual intervals of commands, that are silence


def with_command_end(recording: Recording) -> Recording:
    """Return the recording with a note where its inputs end well before its motion does."""
    inputs = [channel.t for name, channel in recording.channels.items() if is_held(name) and len(channel) > 1]
    motion = [channel.t[-1] for name, channel in recording.channels.items() if not is_held(name) and len(channel)]
    if not inputs or not motion:
        return recording
    end, first = max(float(t[-1]) for t in inputs), min(float(t[0]) for t in inputs)
    usual = max(float(np.median(np.diff(t))) for t in inputs)
    silence = max(map(float, motion)) - end
    if silence <= max(_PAUSE, _INTERVALS * usual):
        return recording
    return recording.with_notes(
        f"the last command came {silence:.1f} s before the motion ends and counts until then; if the vehicle was "
        f"switched off or caught, cut with --window {max(first, recording.start):.2f},{end:.2f}"
    )
