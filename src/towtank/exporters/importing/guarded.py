"""XML of strangers, read without entities and within limits; and what comes of it.

A source names in `Imported.left` what it did not understand, so that nothing of a file is dropped in silence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, ParseError

from towtank.errors import InputError
from towtank.vehicle import Vehicle

__all__ = ["Imported", "number", "numbers", "read_xml"]

_LARGEST = 20_000_000  # bytes
_MOST, _DEEPEST = 200_000, 60  # elements, levels
_LARGEST_NUMBER = 1e15


class Imported(NamedTuple):
    """A vehicle out of a simulator's file.

    Attributes:
        vehicle: in FRD and NED. source: the kind of file. doubts: values that are known or look to be wrong.
        left: what of the file was not understood, or has no place in a vehicle.
    """

    vehicle: Vehicle
    source: str
    doubts: tuple[str, ...] = ()
    left: tuple[str, ...] = ()


def read_xml(path: Path) -> tuple[Element, str]:
    """Return the root of an XML file, and its text.

    Raises:
        InputError: no such file, too large or too deep, not XML, or it has entities or a document type.
    """
    import defusedxml.ElementTree as guarded
    from defusedxml import DefusedXmlException

    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a folder, expected a file such as model.sdf or robot.urdf") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > _LARGEST:
        raise InputError(f"{path}: found {len(data)} bytes, expected at most {_LARGEST}")
    try:
        root: Element = guarded.fromstring(data, forbid_dtd=True)
    except ParseError as error:
        line, column = error.position
        raise InputError(f"{path}:{line}:{column}: not valid XML ({str(error).partition(':')[0]})") from None
    except DefusedXmlException:
        text = "found a document type or entities, expected an XML file without; take them out"
        raise InputError(f"{path}: {text}") from None
    except (ValueError, LookupError, RecursionError) as error:
        raise InputError(f"{path}: not valid XML ({error})") from None
    for count, (level, _) in enumerate(_walked(root)):
        if count > _MOST or level > _DEEPEST:
            raise InputError(f"{path}: found more than {_MOST} elements or {_DEEPEST} levels; this is no vehicle")
    return root, data.decode("utf-8", "replace")


def _walked(root: Element) -> Iterator[tuple[int, Element]]:
    waiting = [(0, root)]
    while waiting:
        level, each = waiting.pop()
        yield level, each
        waiting += [(level + 1, below) for below in each]


def number(text: str | None, place: str) -> float:
    """Return a number of a file. Raises InputError where it is none, or not finite."""
    try:
        value = float((text or "").strip())
    except ValueError:
        shown = "nothing" if text is None or not text.strip() else f'"{text.strip()[:40]}"'
        cure = "; expand the xacro first (xacro model.xacro > model.urdf)" if text and "${" in text else ""
        raise InputError(f"{place}: found {shown}, expected a number{cure}") from None
    if not math.isfinite(value) or abs(value) > _LARGEST_NUMBER:
        raise InputError(f"{place}: found {value:g}, expected a finite number of at most {_LARGEST_NUMBER:g}")
    return value


def numbers(text: str | None, count: int, place: str) -> tuple[float, ...]:
    """Return `count` numbers with blanks between. Raises InputError."""
    parts = (text or "").split()
    if len(parts) != count:
        raise InputError(f"{place}: found {len(parts)} numbers, expected {count}")
    return tuple(number(part, place) for part in parts)
