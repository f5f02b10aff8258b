"""Payloads of one MAVLink message as tables, one for each instance of a sensor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.tables import RecordColumns, Table, texts
from towtank.readers.mavlink.format import MessageLayout
from towtank.readers.mavlink.senders import KIND

__all__ = ["tables_by_instance"]

_MOST_INSTANCES = 64


def tables_by_instance(layout: MessageLayout, payloads: Sequence[bytes], t: Array) -> list[tuple[str, Table]]:
    """Return instance and table of one message by one sender, "" where there are no instances.

    Args:
        layout: of the message.
        payloads: (n) of its messages. t: their times (n,) [s].
    """
    records = layout.rows(list(payloads))
    words = {name: texts(records, name) for name in layout.texts}
    whole = Table(layout.name, t, RecordColumns(records, layout.places), KIND, text=words)
    if layout.instance in words:
        keys = np.array(words[layout.instance])
    elif layout.instance in layout.places:
        keys = records[layout.instance].astype(np.str_)
    else:
        return [("", whole)]
    instances = np.unique(keys)
    if instances.size > _MOST_INSTANCES:
        return [("", whole)]
    parts = []
    for instance in instances:
        own = np.flatnonzero(keys == instance)
        text = {name: tuple(values[i] for i in own) for name, values in words.items()}
        table = Table(layout.name, t[own], RecordColumns(records[own], layout.places), KIND, text=text)
        parts.append((str(instance), table))
    return parts
