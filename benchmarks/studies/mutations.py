"""Ways to break a file: cut, flip, splice, overwrite, repeat, reorder."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

__all__ = ["MUTATIONS", "mutated"]

_RUN = 4000  # bytes at most that are overwritten or inserted
_EXTREMES = (
    b"\xff" * 8, b"\0" * 8, b"\x7f" + b"\xff" * 7, b"\xff" * 7 + b"\x7f", b"\0\0\xc0\x7f", b"\0\0\x80\x7f",
    b"\0\0\0\0\0\0\xf8\x7f", b"\0\0\0\0\0\0\xf0\x7f", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"1e999", b"nan", b"\n", b",",
)  # fmt: skip
Mutation = Callable[[bytearray, Sequence[bytes], random.Random], bytearray]


def _place(data: bytearray, rng: random.Random) -> int:
    """Return a place, half of the time near the beginning, where headers are."""
    return rng.randrange(min(len(data), 400) if rng.random() < 0.5 else len(data)) if data else 0


def _cut(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    return data[: rng.randrange(len(data) + 1)]


def _behead(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    return data[_place(data, rng) :]


def _flip(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    for _ in range(rng.choice((1, 1, 3, 30, 300))):
        if data:
            data[_place(data, rng)] ^= 1 << rng.randrange(8)
    return data


def _extreme(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    for _ in range(rng.choice((1, 1, 4))):
        value, at = rng.choice(_EXTREMES), _place(data, rng)
        data[at : at + len(value)] = value
    return data


def _noise(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    at = _place(data, rng)
    size = min(rng.randrange(1, _RUN), len(data) - at)
    data[at : at + size] = rng.randbytes(size)
    return data


def _run(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    at = _place(data, rng)
    size = min(rng.randrange(1, _RUN), len(data) - at)
    data[at : at + size] = bytes((rng.choice((0, 0xFF, 0xFD, 0xA3, 0x95, 0x20, data[at] if data else 0)),)) * size
    return data


def _insert(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    at = _place(data, rng)
    data[at:at] = rng.randbytes(rng.choice((1, 1, 2, rng.randrange(1, 300))))
    return data


def _delete(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    at = _place(data, rng)
    del data[at : at + rng.choice((1, 1, 2, rng.randrange(1, 300)))]
    return data


def _splice(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    other = rng.choice(others) if others else bytes(data)
    start = rng.randrange(len(other))
    return data[: _place(data, rng)] + other[start : start + rng.randrange(1, 60_000)]


def _graft(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    other = rng.choice(others) if others else bytes(data)
    at, start = _place(data, rng), rng.randrange(len(other))
    data[at:at] = other[start : start + rng.randrange(1, _RUN)]
    return data


def _repeat(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    start = rng.randrange(len(data)) if rng.random() < 0.5 and data else 0
    return data + data[start:]


def _reorder(data: bytearray, others: Sequence[bytes], rng: random.Random) -> bytearray:
    cuts = sorted(rng.randrange(len(data) + 1) for _ in range(3))
    return data[: cuts[0]] + data[cuts[1] : cuts[2]] + data[cuts[0] : cuts[1]] + data[cuts[2] :]


MUTATIONS: dict[str, Mutation] = {
    "cut": _cut, "behead": _behead, "flip": _flip, "extreme": _extreme, "noise": _noise, "run": _run, "insert": _insert,
    "delete": _delete, "splice": _splice, "graft": _graft, "repeat": _repeat, "reorder": _reorder,
}  # fmt: skip


def mutated(data: bytes, others: Sequence[bytes], rng: random.Random) -> tuple[str, bytes]:
    """Return the name of a mutation, or two, and the broken file.

    Args:
        data: the whole file.
        others: files of other formats, to splice with.
        rng: seeded.
    """
    names = [rng.choice(list(MUTATIONS)) for _ in range(1 if rng.random() < 0.8 else 2)]
    broken = bytearray(data)
    for name in names:
        broken = MUTATIONS[name](broken, others, rng) if broken else broken
    return "+".join(names), bytes(broken)
