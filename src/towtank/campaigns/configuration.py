"""A campaign as its file says it, checked on reading: what is done, with which logs, vehicles and options.

kind = "learn"                             # or "validate", "simulate-learn"
logs = ["archive/*/*.BIN"]                 # paths begin in the file's folder; or s3://BUCKET/*.BIN, gs://..
vehicle = "bluerov2_heavy"                 # for all logs; or by folder:
[vehicle]
"rov*" = "bluerov2_heavy"                  # archive/rov7/a.BIN is of the vehicle rov7
boat = "boat.toml"
[study]                                    # of simulate-learn, in place of logs
manoeuvre = "all-multisine"
vehicles = 5
runs = 8
[study.between]
"X_*" = 0.10                               # deviation from vehicle to vehicle, a share
"""

from __future__ import annotations

import fnmatch
import hashlib
import json
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from towtank.errors import InputError, nearest
from towtank.methods import METHODS
from towtank.recording.mapping import mapping_of
from towtank.simulation import MANOEUVRES, SENSORS
from towtank.vehicle import COEFFICIENTS, Vehicle
from towtank.vehicle.base import NonNegative, Positive, Record, Vector, described, first_line, listed, misplaced
from towtank.vehicle.files import catalog_names, catalog_text, parse_vehicle, vehicle_text

__all__ = ["KINDS", "Campaign", "KnownVehicle", "Study", "read_campaign"]

KINDS = ("learn", "validate", "simulate-learn")
_LINE_COLUMN = re.compile(r" \(at line (\d+), column (\d+)\)")
_LARGEST = 1_000_000_000


def _one_of(*known: str) -> BeforeValidator:
    def check(value: Any) -> str:
        if not isinstance(value, str) or value not in known:
            hint = nearest(value, known) if isinstance(value, str) else ""
            raise ValueError(f"found {described(value)}, expected one of {', '.join(known)}{hint}")
        return value

    return BeforeValidator(check)


def _whole(least: int) -> BeforeValidator:
    def check(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= _LARGEST:
            raise ValueError(f"found {described(value)}, expected a whole number of {least} or more")
        return value

    return BeforeValidator(check)


def _texts(value: Any) -> list[str]:
    items = [value] if isinstance(value, str) else listed(value, "a text or a list of texts")
    for each in items:
        if not isinstance(each, str) or not each:
            raise ValueError(f"found {described(each)}, expected texts")
    return items


def _shares(value: dict[str, float]) -> dict[str, float]:
    for pattern, share in value.items():
        if not fnmatch.filter(COEFFICIENTS, pattern):
            raise misplaced(pattern, f"there is no such coefficient{nearest(pattern, COEFFICIENTS)}")
        if share > 1.0:
            raise misplaced(pattern, f"found {share:g}, expected a share of 1 or less, as 0.1 for 10 %")
    return value


_Texts = Annotated[tuple[str, ...], BeforeValidator(_texts)]
_Shares = Annotated[dict[str, NonNegative], AfterValidator(_shares)]


class Study(Record):
    """Simulated runs: the manoeuvre, the sensors, how many of how many vehicles, and what varies.

    Attributes:
        duration: [s], the manoeuvre's own where omitted. rate: of the commands [Hz]. disturbance: deviation of a random
            force [N]. current: of the water [m/s], NED. runs: of each vehicle.
        between, within: deviations by coefficient or pattern, shares of what the file gives: from vehicle to vehicle,
            and from run to run.
    """

    manoeuvre: Annotated[str, _one_of(*MANOEUVRES)]
    duration: Positive | None = None
    rate: Positive = 100.0
    sensors: Annotated[str, _one_of(*SENSORS)] = "mocap"
    disturbance: NonNegative = 0.0
    current: Vector = (0.0, 0.0, 0.0)
    vehicles: Annotated[int, _whole(1)] = 1
    runs: Annotated[int, _whole(1)] = 1
    seed: Annotated[int, _whole(0)] = 1
    between: _Shares = Field(default_factory=dict)
    within: _Shares = Field(default_factory=dict)


class CampaignFile(Record):
    """The keys of a campaign's file; what they mean stands in the documentation."""

    kind: Annotated[str, _one_of(*KINDS)]
    vehicle: str | dict[str, str]
    logs: _Texts = ()
    method: Annotated[str, _one_of(*METHODS)] = "joint"
    free: _Texts = ()
    map: str | None = None
    prior: str | None = None
    delay: NonNegative | None = None
    keep_all: bool = False
    horizon: Positive | None = None
    study: Study | None = None

    @model_validator(mode="before")
    @classmethod
    def _vehicle_known(cls, data: Any) -> Any:
        given = data.get("vehicle") if isinstance(data, Mapping) else None
        if given is not None and not isinstance(given, str):
            if not isinstance(given, Mapping) or not given:
                raise misplaced("vehicle", f"found {described(given)}, expected a text, or a table of folders")
            for name, value in given.items():
                if not isinstance(value, str):
                    raise misplaced(f"vehicle.{name}", f"found {described(value)}, expected a vehicle file or name")
        return data

    @model_validator(mode="after")
    def _whole_campaign(self) -> Self:
        simulated = self.kind == "simulate-learn"
        if simulated and self.study is None:
            raise misplaced("study", "missing; simulate-learn needs [study] with manoeuvre and runs")
        if not simulated and self.study is not None:
            raise misplaced("study", f"found beside kind {self.kind}, expected only with simulate-learn")
        if not simulated and not self.logs:
            raise misplaced("logs", 'missing; expected patterns of logs, as ["archive/*/*.BIN"]')
        if simulated and isinstance(self.vehicle, dict):
            raise misplaced("vehicle", "found a table of folders, expected one vehicle to simulate")
        strange: tuple[str, ...] = ("logs", "map", "keep_all", "horizon") if simulated else ()
        strange += ("horizon",) if self.kind == "learn" else ()
        strange += ("method", "free", "prior") if self.kind == "validate" else ()
        for name in strange:
            if name in self.model_fields_set:
                raise misplaced(name, f"has no meaning for kind {self.kind}; leave it out")
        if self.method == "paper" and self.prior is not None:
            raise misplaced("prior", "the method paper takes none; use joint or output-error, or leave it out")
        return self


@dataclass(frozen=True)
class KnownVehicle:
    """A vehicle that a campaign supposes: the text of its file, and its name, the class of all that share it."""

    text: str
    name: str


@dataclass(frozen=True)
class Campaign:
    """A campaign with everything that its file names read in.

    Attributes:
        file: its keys. folder: that paths begin in. vehicles: by the pattern of their folders; by "*" the only one.
        mapping, prior: the texts of these files, empty where there is none.
    """

    file: CampaignFile
    folder: Path
    vehicles: Mapping[str, KnownVehicle]
    mapping: str = ""
    prior: str = ""
    place: str = field(default="campaign", compare=False)

    @property
    def kind(self) -> str:
        """What is done: one of `KINDS`."""
        return self.file.kind

    @property
    def settings(self) -> dict[str, Any]:
        """Everything that bears on what a task computes beside its own input, in plain values; contents as hashes."""
        file = self.file
        out: dict[str, Any] = {"kind": file.kind}
        out["vehicle"] = {pattern: digest(known.text) for pattern, known in sorted(self.vehicles.items())}
        out |= {"method": file.method, "free": list(file.free), "delay": file.delay, "keep_all": file.keep_all}
        out |= {"horizon": file.horizon, "map": digest(self.mapping), "prior": digest(self.prior)}
        if file.study is not None:  # the first runs of a longer study are those of a shorter one
            out["study"] = file.study.model_dump(exclude={"runs", "vehicles"})
        return out

    def vehicle_of(self, label: str) -> tuple[str, KnownVehicle]:
        """Return which vehicle made a log, by the folders that it lies in, and what is supposed of it.

        With one vehicle for all it is called by the folder of the log. Raises InputError where no folder is known.
        """
        folders = PurePosixPath(label).parts[:-1]
        if isinstance(self.file.vehicle, str):
            [known] = self.vehicles.values()
            return (folders[-1] if folders else known.name), known
        for name in reversed(folders):
            if name in self.vehicles:
                return name, self.vehicles[name]
            for pattern, known in self.vehicles.items():
                if pattern != "*" and fnmatch.fnmatchcase(name, pattern):
                    return name, known
        if "*" in self.vehicles:
            return (folders[-1] if folders else self.vehicles["*"].name), self.vehicles["*"]
        raise InputError(
            f'{self.place}: [vehicle] names no folder of {label}; add one of its folders, or "*" for all others'
        )


def digest(text: str) -> str:
    """Return a hash of a text, empty for an empty one."""
    return hashlib.sha256(text.encode()).hexdigest()[:32] if text else ""


def canonical(document: Mapping[str, Any]) -> str:
    """Return a document as one text, the same for equal documents."""
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)


def read_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Return the campaign of a TOML file, the vehicles, mapping and prior that it names read in.

    Raises:
        InputError: the file or one that it names cannot be read; a key, type or value that is not allowed.
    """
    path = Path(path)
    data = _toml(path)
    try:
        file = CampaignFile.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {first_line(error, data)}") from None
    folder = path.absolute().parent
    given = file.vehicle if isinstance(file.vehicle, dict) else {"*": file.vehicle}
    vehicles = dict[str, KnownVehicle]()
    for pattern, named in given.items():
        where = f"{path}: vehicle" if isinstance(file.vehicle, str) else f"{path}: vehicle.{pattern}"
        known = _vehicle(named, folder, where)
        vehicles[pattern] = KnownVehicle(vehicle_text(known), known.name)
        for other, held in vehicles.items():
            if held.name == known.name and held.text != vehicles[pattern].text:
                raise InputError(
                    f'{where}: "{named}" is another vehicle than that of vehicle.{other}, but has the same name '
                    f'"{known.name}", which names a class; give one of the two another name'
                )
        if file.study is not None:
            _varying(file.study, known, path)
    mapping = "" if file.map is None else _text(folder / file.map, f"{path}: map")
    if mapping:
        mapping_of(folder / str(file.map))  # says what is wrong with it
    prior = "" if file.prior is None else vehicle_text(_vehicle(file.prior, folder, f"{path}: prior"))
    return Campaign(file, folder, vehicles, mapping, prior, str(path))


def _varying(study: Study, vehicle: Vehicle, path: Path) -> None:
    """Raise InputError for what is to vary and is not there."""
    there = [name for name in COEFFICIENTS if vehicle.coefficient(name) != 0.0]
    for key in ("between", "within"):
        for pattern in getattr(study, key):
            if not any(fnmatch.fnmatchcase(name, pattern) for name in there):
                raise InputError(
                    f"{path}: study.{key}.{pattern}: {vehicle.name} has no such coefficient, and nothing would vary; "
                    f"it has {', '.join(there)}"
                )


def _vehicle(named: str, folder: Path, where: str) -> Vehicle:
    """Return a vehicle of the catalog, or of a file whose path begins in a folder."""
    if named in catalog_names():
        return parse_vehicle(catalog_text(named), f"{named} (catalog)")
    path = folder / named
    if not path.is_file():
        raise InputError(
            f'{where}: "{named}" is neither a vehicle of the catalog{nearest(named, catalog_names())} nor a file in '
            f"{folder}"
        )
    return parse_vehicle(_text(path, where), str(path))


def _text(path: Path, where: str) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{where}: {path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: {path}: cannot be read ({error})") from None


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; expected the file of a campaign (.toml)") from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a folder, expected the file of a campaign (.toml)") from None
    except tomllib.TOMLDecodeError as error:
        place = _LINE_COLUMN.search(str(error))
        where = f"{path}:{place[1]}:{place[2]}" if place else str(path)
        raise InputError(f"{where}: not valid TOML: {_LINE_COLUMN.sub('', str(error))}") from None
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: cannot be read as TOML ({error})") from None
