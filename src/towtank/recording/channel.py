"""One measured or commanded quantity over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording.standard import STANDARD, is_standard, standard_of

__all__ = ["Channel", "in_one_block", "read_only", "standard_channel"]


def read_only(values: ArrayLike) -> Array:
    """Return `values` as a read-only float64 array, copied unless it already is one."""
    array = np.asarray(values, dtype=np.float64)
    if array.flags.writeable or (array.base is not None and _has_writeable_base(array)):
        array = array.copy()
        array.flags.writeable = False
    return array


def in_one_block(values: Array) -> Array:
    """Return `values`, which are read-only, as kernels take them: contiguous; copied unless they are."""
    array = np.ascontiguousarray(values)
    array.flags.writeable = False
    return array


def _has_writeable_base(array: Array) -> bool:
    base = array.base
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return True
        base = base.base
    return False


@dataclass(frozen=True, eq=False)
class Channel:
    """Samples of one quantity at its own times. Immutable; the arrays are read-only. NumPy takes it as its values.

    Attributes:
        name: standard name ("u", "psi", "cmd_aft_port", ...) or any other one.
        t: times (n,) [s], finite, strictly increasing; several channels may share one array.
        values: values (n,) in `unit`; NaN where not measured, never infinite.
        unit, frame: as in `standard.STANDARD`; a standard name admits only its own unit and frame.

    Raises:
        InputError: any of these does not hold.
    """

    name: str
    t: Array
    values: Array
    unit: str = ""
    frame: str = ""

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("found a channel without a name, expected one")
        try:
            object.__setattr__(self, "t", read_only(self.t))
            object.__setattr__(self, "values", read_only(self.values))
        except (TypeError, ValueError) as error:
            raise InputError(f'channel "{self.name}": times and values must be numbers ({error})') from error
        self._check_arrays()
        if is_standard(self.name):
            known = standard_of(self.name)
            if (self.unit, self.frame) != (known.unit, known.frame):
                raise InputError(
                    f'channel "{self.name}": found unit "{self.unit}" and frame "{self.frame}", '
                    f'expected "{known.unit}" and "{known.frame}"'
                )

    def _check_arrays(self) -> None:
        t, values = self.t, self.values
        if t.ndim != 1 or t.shape != values.shape:
            raise InputError(
                f'channel "{self.name}": found times of shape {t.shape} and values of shape {values.shape}, '
                "expected two arrays of one length"
            )
        if not np.isfinite(t).all():
            raise InputError(f'channel "{self.name}": every time must be finite')
        if t.size > 1 and not (t[1:] > t[:-1]).all():
            i = int(np.argmin(t[1:] > t[:-1]))
            raise InputError(
                f'channel "{self.name}": time must increase, found {float(t[i])!r} s and then '
                f"{float(t[i + 1])!r} s (sample {i + 1})"
            )
        if np.isinf(values).any():
            raise InputError(f'channel "{self.name}": found an infinite value; use NaN where not measured')

    def __len__(self) -> int:
        return int(self.t.size)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Channel):
            return NotImplemented
        return (
            (self.name, self.unit, self.frame) == (other.name, other.unit, other.frame)
            and np.array_equal(self.t, other.t)
            and np.array_equal(self.values, other.values, equal_nan=True)
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        unit = " ".join(text for text in (self.unit, self.frame) if text)
        told = f", {unit}" if unit else ""
        if not len(self):
            return f"<Channel {self.name}: empty{told}>"
        known = self.values[np.isfinite(self.values)]
        span = f", {known.min():.4g} .. {known.max():.4g}" if known.size else ", not measured"
        return f"<Channel {self.name}: {len(self)} samples, {self.t[0]:.6g} .. {self.t[-1]:.6g} s{span}{told}>"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        """Return the values (n,); the channel's own, read-only array unless another type or a copy is asked for."""
        return np.array(self.values, dtype=dtype, copy=copy)

    def __reduce__(self) -> tuple[Any, ...]:
        return Channel, (self.name, self.t, self.values, self.unit, self.frame)

    @property
    def measured(self) -> Channel:
        """The channel without its NaN samples (itself where there are none)."""
        known = ~np.isnan(self.values)
        if known.all():
            return self
        return Channel(self.name, self.t[known], self.values[known], self.unit, self.frame)

    def with_values(self, values: ArrayLike) -> Channel:
        """The same channel with other values at the same times."""
        return Channel(self.name, self.t, read_only(values), self.unit, self.frame)

    def renamed(self, name: str) -> Channel:
        """The same samples under another name; a standard name brings its unit and frame."""
        if is_standard(name):
            return standard_channel(name, self.t, self.values)
        return Channel(name, self.t, self.values, self.unit, self.frame)


def standard_channel(name: str, t: ArrayLike, values: ArrayLike) -> Channel:
    """Return a channel with unit and frame of its standard name. Raises InputError for an unknown name."""
    if not is_standard(name):
        raise InputError(
            f'unknown channel "{name}"{nearest(name, STANDARD)}; expected a standard name or cmd_<thruster>'
        )
    known = standard_of(name)
    return Channel(name, read_only(t), read_only(values), known.unit, known.frame)
