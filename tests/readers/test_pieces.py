"""Interpreting pieces of a log is interpreting the whole: a live link calls the same functions with a few rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.readers.ardupilot.aiding import Aiding
from towtank.readers.common.sources import Source
from towtank.readers.common.tables import Table
from towtank.readers.dataflash.meaning import sources_of_messages as of_dataflash
from towtank.readers.dataflash.records import decode_binary
from towtank.readers.mavlink.autopilot import with_autopilot
from towtank.readers.mavlink.meaning import sources_of_messages as of_mavlink
from towtank.readers.mavlink.tlog import decode

from .encoders import dive_bin, dive_tlog

HALF = Aiding(np.array([0.0, 1.0]), np.array([True, False]), np.array([True, False]), "")


def _mavlink_tables() -> Iterable[Table]:
    tables, senders = decode(bytes(dive_tlog(3.0).data), "log")
    return with_autopilot(tables, senders).tables.values()


CASES: dict[str, tuple[list[Table], Callable[[Table], list[Source]]]] = {
    "dataflash": (
        list(decode_binary(bytes(dive_bin(2.0).data), "log").tables.values()),
        lambda table: of_dataflash(table, HALF),
    ),
    "mavlink": (list(_mavlink_tables()), lambda table: of_mavlink(table, HALF, measured=False)),
}


@pytest.mark.parametrize("kind", CASES)
@given(cuts=st.lists(st.integers(0, 100), max_size=4))
@settings(max_examples=20, deadline=None)
def test_pieces_give_what_the_whole_gives(kind: str, cuts: list[int]) -> None:
    tables, sources = CASES[kind]
    told = 0
    for table in tables:
        whole = sources(table)
        edges = [0, *sorted(cut for cut in cuts if cut < len(table)), len(table)]
        pieces = [sources(table.rows(a, b)) for a, b in pairwise(edges) if b > a]
        assert all([each.quantity for each in piece] == [each.quantity for each in whole] for piece in pieces)
        for i, source in enumerate(whole):
            np.testing.assert_array_equal(np.concatenate([piece[i].t for piece in pieces]), source.t)
            for name, values in source.channels.items():
                told += 1
                parts = [piece[i].channels[name] for piece in pieces]
                if not any(piece[i].refused for piece in pieces):
                    np.testing.assert_array_equal(np.concatenate(parts), values)
    assert told > 10
