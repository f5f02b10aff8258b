"""The last seconds of rows and inputs, as they came, to be gone over again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from towtank.identification.joint_buffer import Buffer
from towtank.identification.samples import Samples

__all__ = ["Recent"]


class Recent:
    """Pieces of a stream.

    Args:
        seconds: that are kept.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._pieces: list[Samples] = []

    def add(self, buffer: Buffer) -> Samples:
        """Take what is in a buffer, empty it, and forget what is too old; return what was taken."""
        rows = buffer.whole
        piece = replace(
            rows,
            t=rows.t.copy(),
            values=rows.values.copy(),
            input_t=rows.input_t.copy(),
            input_force=rows.input_force.copy(),
        )
        buffer.clear()
        if len(piece) or piece.input_t.size:
            self._pieces.append(piece)
            newest = piece.t[-1] if len(piece) else piece.input_t[-1]
            while len(self._pieces[0]) and self._pieces[0].t[-1] < newest - self._seconds:
                self._pieces.pop(0)
        return piece

    def since(self, t: float) -> Samples:
        """Return what came after t [s], in one; t is the time of a row."""
        pieces = [each for each in self._pieces if not len(each) or each.t[-1] > t]
        whole = replace(
            pieces[0],
            t=np.concatenate([each.t for each in pieces]),
            values=np.concatenate([each.values for each in pieces]),
            input_t=np.concatenate([each.input_t for each in pieces]),
            input_force=np.concatenate([each.input_force for each in pieces]),
        )
        first = int(np.searchsorted(whole.t, t, side="right"))
        return whole.part(first, int(np.searchsorted(whole.input_t, t, side="right")))

    def clear(self) -> None:
        """Forget everything."""
        self._pieces.clear()
