"""A vehicle: all that the model (8) needs, as one frozen record, and the same as the kernels' vector.

A dictionary that cannot be changed, so that records which hold one are frozen, hashable and picklable.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, NoReturn, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, field_validator, model_validator
from pydantic_core import PydanticCustomError

from towtank.core.arrays import Array
from towtank.core.inertia import rigid_body_mass
from towtank.digits import measured, short
from towtank.errors import InputError, nearest
from towtank.notebook import html_table
from towtank.vehicle import matrices
from towtank.vehicle.base import NonNegative, Record, Share, described, first_line, misplaced, unknown_key
from towtank.vehicle.checks import doubts, faults
from towtank.vehicle.names import COEFFICIENTS, HYDRODYNAMIC, RESTORING, ROWS, index, mirror
from towtank.vehicle.posterior import GAIN_PREFIX, Posterior, drawn, known_unknowns, stated_before
from towtank.vehicle.records import Buoyancy, Coefficient, Provenance, Restoring, RigidBody, Thruster

__all__ = ["Vehicle"]

_K = TypeVar("_K")
_V = TypeVar("_V")
_WORDS = {"name", "description", "provenance"}  # fields whose change leaves what was learned as it is


class FrozenDict(dict[_K, _V]):
    """A dict whose every changing method raises TypeError."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("this record is frozen; use with_coefficients to make a changed copy")

    __setitem__ = __delitem__ = _refuse
    __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __hash__(self) -> int:  # type: ignore[override]
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)

    def __copy__(self) -> FrozenDict[_K, _V]:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> FrozenDict[_K, _V]:
        return self


def _name(value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"found {described(value)}, expected a name")
    return value


def _known_coefficients(value: Any) -> Any:
    if isinstance(value, Mapping):
        for key in value:
            if key in RESTORING:
                raise misplaced(str(key), "unknown key here; it belongs in the table [restoring]")
            if key not in HYDRODYNAMIC:
                raise unknown_key(str(key), list(HYDRODYNAMIC))
    return value


_Hydrodynamics = Annotated[dict[str, Coefficient], BeforeValidator(_known_coefficients), AfterValidator(FrozenDict)]
_Prior = Annotated[dict[str, Coefficient], BeforeValidator(known_unknowns), AfterValidator(FrozenDict)]


class Vehicle(Record):
    """A vehicle, as its file says it. Frozen; `with_coefficients` makes a changed copy.

    `command_delay` [s] is the time from command to thruster. `scale_std` is the relative standard deviation of the
    scale of force that all thrusters have in common; None where the file does not say. `prior` is what is known of
    single unknowns before any data: coefficients by name, `delay`, `lag`, `latency_<sensor>` [s] and `gain_<thruster>`,
    each with a deviation. `posterior` is what was learned with its covariance, None where nothing was; a copy with
    other numbers has none, unless it is given one.
    """

    name: Annotated[str, BeforeValidator(_name)]
    description: str = ""
    rigid_body: RigidBody
    buoyancy: Buoyancy = Buoyancy()
    restoring: Restoring = Restoring()
    hydrodynamics: _Hydrodynamics = FrozenDict()
    thrusters: tuple[Thruster, ...] = ()
    command_delay: NonNegative = 0.0
    scale_std: Share | None = None
    provenance: Provenance = Provenance()
    prior: _Prior = FrozenDict()
    posterior: Posterior | None = None

    @field_validator("hydrodynamics", "prior", mode="after")
    @classmethod
    def _units(cls, value: dict[str, Coefficient], info: Any) -> FrozenDict[str, Coefficient]:
        completed = {}
        for name, coefficient in value.items():
            try:
                stated = info.field_name == "prior"
                completed[name] = stated_before(name, coefficient) if stated else coefficient.with_unit(name)
            except PydanticCustomError as error:
                context = error.context or {}
                raise misplaced(f"{name}.{context['place']}", context["text"]) from None
        return FrozenDict(completed)

    @field_validator("thrusters", mode="before")
    @classmethod
    def _list_of_tables(cls, value: Any) -> Any:
        if not isinstance(value, list | tuple):
            raise ValueError(f"found {described(value)}, expected a list of tables; write [[thrusters]]")
        return value

    @model_validator(mode="after")
    def _distinct_thrusters(self) -> Vehicle:
        seen: dict[str, int] = {}
        for k, thruster in enumerate(self.thrusters):
            if thruster.name in seen:
                raise misplaced(
                    f"thrusters[{k}].name",
                    f'"{thruster.name}" is already the name of thrusters[{seen[thruster.name]}]'
                    "; give each thruster its own",
                )
            seen[thruster.name] = k
        places = {
            f"posterior.names[{k}]": name for k, name in enumerate(self.posterior.names if self.posterior else ())
        }
        places |= {f"prior.{name}": name for name in (self.prior if self.thrusters else ())}
        for place, name in places.items():
            thruster_name = name.removeprefix(GAIN_PREFIX)
            if name.startswith(GAIN_PREFIX) and thruster_name not in seen:
                hint = nearest(thruster_name, seen)
                raise misplaced(place, f'found "{name}", but no thruster is "{thruster_name}"{hint}')
        return self

    @model_validator(mode="after")
    def _inertias_before(self) -> Vehicle:
        for name, line in self.prior.items():
            kind, i, j = index(name) if name in COEFFICIENTS else ("", 0, 1)
            rigid = float(self.rigid_body_matrix[i, i])
            if kind == "mass" and i == j and line.value >= rigid:
                text = f"found {line.value:g}, expected less than the rigid body's {rigid:g}: a total inertia above 0"
                raise misplaced(f"prior.{name}.value", text)
        return self

    # -- forces of gravity and buoyancy

    @property
    def weight(self) -> float:
        """Weight W = m g [N], g = 9.81 m/s^2."""
        return self.rigid_body.mass * matrices.GRAVITY

    @property
    def buoyant_force(self) -> float:
        """Buoyant force B [N] of the table [buoyancy]; equal to the weight where it is not given."""
        return self.weight if self.buoyancy.force is None else self.buoyancy.force

    @property
    def weight_minus_buoyancy(self) -> float:
        """W - B [N] in effect."""
        measured = self.restoring.W_minus_B
        return self.weight - self.buoyant_force if measured is None else measured.value

    @property
    def restoring_moment(self) -> tuple[float, float, float]:
        """(BG_x, BG_y, BG_z) = r_G W - r_B B [N m/rad] in effect."""
        measured = (self.restoring.BG_x, self.restoring.BG_y, self.restoring.BG_z)
        r_G, r_B = self.rigid_body.centre_of_gravity, self.buoyancy.centre
        x, y, z = (
            r_G[k] * self.weight - r_B[k] * self.buoyant_force if measured[k] is None else measured[k].value  # type: ignore[union-attr]
            for k in range(3)
        )
        return x, y, z

    # -- matrices

    @cached_property
    def _values(self) -> dict[str, float]:
        return {name: coefficient.value for name, coefficient in self.hydrodynamics.items()}

    @cached_property
    def rigid_body_matrix(self) -> Array:
        """M_RB (6, 6) about the body origin [kg, kg m, kg m^2], read-only."""
        body = self.rigid_body
        return _read_only(rigid_body_mass(body.mass, np.array(body.centre_of_gravity), body.tensor))

    @cached_property
    def added_mass_matrix(self) -> Array:
        """M_A (6, 6), symmetric, read-only."""
        return _read_only(matrices.added_mass_matrix(self._values))

    @cached_property
    def mass_matrix(self) -> Array:
        """Total mass matrix M = M_RB + M_A (6, 6), symmetric, read-only."""
        return _read_only(self.rigid_body_matrix + self.added_mass_matrix)

    @cached_property
    def parameters(self) -> Array:
        """The kernels' vector (170,), read-only; see `towtank.core.layout`.

        Raises:
            InputError: the total mass matrix is singular.
        """
        row = matrices.singular_row(self.mass_matrix)
        if row is not None:
            raise InputError(
                f"{self.name}: the total mass matrix is singular in row {ROWS[row]}, so no motion can be computed"
                "; give rigid_body.inertia or the added mass of that axis a value above 0"
            )
        moment = np.array(self.restoring_moment)
        return _read_only(matrices.parameters(self.mass_matrix, self._values, self.weight_minus_buoyancy, moment))

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What is not physical or doubtful about this vehicle, one line each; empty where all is well."""
        return faults(self) + doubts(self)

    # -- coefficients by name

    def coefficient(self, name: str) -> float:
        """Return the value in effect of a coefficient, 0 where it is absent. Raises InputError for an unknown name."""
        kind, axis, _ = index(name)
        if kind == "weight":
            return self.weight_minus_buoyancy
        if kind == "moment":
            return self.restoring_moment[axis]
        return matrices.effective(self._values, name)

    def deviation(self, name: str) -> float | None:
        """Return the standard deviation that the file gives a coefficient, None where it gives none.

        Raises:
            InputError: an unknown name.
        """
        index(name)
        if name in RESTORING:
            given = getattr(self.restoring, name)
        else:
            given = self.hydrodynamics.get(name) or self.hydrodynamics.get(mirror(name))
        return None if given is None else given.std

    def with_coefficients(
        self, changes: Mapping[str, Coefficient | float], *, provenance: Provenance | None = None
    ) -> Vehicle:
        """Return a copy with some coefficients replaced or added (W_minus_B and BG_x, BG_y, BG_z too).

        An added mass replaces its mirrored name as well, unless both are in `changes`. The posterior is kept where no
        value changes (other deviations or sources), and dropped otherwise: it belongs to the old values.

        Raises:
            InputError: an unknown name, or a value that is not a finite number in SI.
        """
        hydrodynamics = dict(self.hydrodynamics)
        restoring: dict[str, Coefficient | None] = {name: getattr(self.restoring, name) for name in RESTORING}
        for name, change in changes.items():
            kind, _, _ = index(name)
            try:
                coefficient = Coefficient.of(change, name)
            except ValueError as error:
                raise InputError(f"{name}: {first_line(error)}") from error
            if name in RESTORING:
                restoring[name] = coefficient
                continue
            if kind == "mass" and mirror(name) not in changes:
                hydrodynamics.pop(mirror(name), None)
            hydrodynamics[name] = coefficient
        update: dict[str, Any] = {"hydrodynamics": hydrodynamics, "restoring": Restoring(**restoring)}
        if provenance is not None:
            update["provenance"] = provenance
        changed = self.model_copy(update=update)
        if self.posterior is None or any(changed.coefficient(name) != self.coefficient(name) for name in changes):
            return changed
        return changed.model_copy(update={"posterior": self.posterior})

    def sample(self, n: int, seed: int = 0) -> tuple[Vehicle, ...]:
        """Return n vehicles drawn from what is known of this one; the same seed draws the same ones.

        Coordinates are drawn from the posterior N(mean, covariance) and put back into coefficients, time constants and
        gains of thrusters and the command delay, which is never below 0. Without a posterior, coefficients that have
        a `std` are drawn independently of each other (total inertias log-normal), as suits a file typed in by hand.
        Damping on the diagonal that would feed energy in is 0; a draw whose total mass matrix is not positive definite
        is drawn again. Drawn vehicles have no posterior.

        Raises:
            InputError: neither posterior nor std; or no mass matrix drawn is positive definite.
        """
        return drawn(self, n, seed)

    # -- as it is shown

    def __repr__(self) -> str:
        return f"<Vehicle {self.name}: {self._in_short}>"

    __str__ = __repr__

    @property
    def _in_short(self) -> str:
        many = len(self.thrusters)
        thrusters = f"{many} thruster{'' if many == 1 else 's'}" if many else "no thrusters"
        learned = "" if self.posterior is None else f", posterior over {len(self.posterior.names)} unknowns"
        return f"{short(self.rigid_body.mass)} kg, {len(self.hydrodynamics)} coefficients, {thrusters}{learned}"

    def _repr_html_(self) -> str:
        """Return the coefficients as a table, for notebooks."""
        restoring = {name: value for name in RESTORING if (value := getattr(self.restoring, name)) is not None}
        rows = [
            (name, *measured(each.value, each.std), each.unit or "", each.source or "")
            for name, each in {**self.hydrodynamics, **restoring}.items()
        ]
        head = ("Coefficient", ">Value", ">± std", "Unit", "Source")
        return html_table(f"{self.name}: {self._in_short}", head, rows, self.warnings)

    # -- equality, copies and pickles know the fields only, not the cached arrays

    def _fields(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in type(self).model_fields}

    def __eq__(self, other: object) -> bool:
        return self._fields() == other._fields() if isinstance(other, Vehicle) else NotImplemented

    def __hash__(self) -> int:
        return hash(tuple(self._fields().values()))

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Vehicle:
        """Return a validated copy with some fields replaced.

        The posterior is dropped unless it is among them, or they are only name, description and provenance.
        """
        changes = dict(update or {})
        if not changes.keys() <= _WORDS:
            changes.setdefault("posterior", None)
        return type(self)(**{**self._fields(), **changes})

    def __copy__(self) -> Vehicle:
        return self

    def __deepcopy__(self, memo: dict[int, Any] | None = None) -> Vehicle:
        return self

    def __getstate__(self) -> dict[Any, Any]:
        state = dict(super().__getstate__())
        state["__dict__"] = self._fields()
        return state


def _read_only(array: Array) -> Array:
    array.setflags(write=False)
    return array
