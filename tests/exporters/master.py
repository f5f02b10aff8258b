"""A small master for functional mock-up units, FMI 2.0 and 3.0: what the tests need of the standard, by ctypes."""

from __future__ import annotations

import ctypes
import platform
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

_LOGGERS = {
    2: ctypes.CFUNCTYPE(None, *(ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, *(ctypes.c_char_p,) * 3)),
    3: ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p),
}
OK, DISCARD, ERROR = 0, 2, 3


class _Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", _LOGGERS[2]),
        *((name, ctypes.c_void_p) for name in ("allocate", "release", "step_finished", "environment")),
    )


class Description(NamedTuple):
    """What a description says: value references and starts by the variables' names, kinds, units."""

    version: int
    identifier: str
    token: str
    references: dict[str, int]
    kinds: dict[str, str]
    starts: dict[str, float]
    units: dict[str, str]
    known_units: set[str]


def described(path: Path) -> Description:
    """Read modelDescription.xml."""
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    version = int(root.attrib["fmiVersion"][0])
    references, kinds, starts, units = {}, {}, {}, {}
    for each in root.find("ModelVariables") or ():
        name, values = each.attrib["name"], each if version == 3 else each.find("Real")
        references[name] = int(each.attrib["valueReference"])
        kinds[name] = f"{each.attrib['causality']} {each.attrib['variability']}"
        if values is not None and "start" in values.attrib:
            starts[name] = float(values.attrib["start"])
        if values is not None and "unit" in values.attrib:
            units[name] = values.attrib["unit"]
    known = {each.attrib["name"] for each in root.iter("Unit")}
    token = root.attrib["guid" if version == 2 else "instantiationToken"]
    one = root.find("CoSimulation")
    identifier = "" if one is None else one.attrib["modelIdentifier"]
    return Description(version, identifier, token, references, kinds, starts, units, known)


class Unit:
    """An instance of a unit."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.description = described(path)
        self.said: list[str] = []
        self.version = self.description.version
        place = f"binaries/{'linux64' if self.version == 2 else platform.machine() + '-linux'}"
        with zipfile.ZipFile(path) as archive:
            library = archive.extract(f"{place}/{self.description.identifier}.so", folder)
        self._library: Any = ctypes.CDLL(library)
        name, token = b"tank", self.description.token.encode()
        if self.version == 2:
            logger = _LOGGERS[2](lambda _, __, status, category, text, first: self.said.append(f"{status} {first!r}"))
            self._kept: Any = _Callbacks(logger, None, None, None, None)
            make = self._library.fmi2Instantiate
            make.restype = ctypes.c_void_p
            self._unit = ctypes.c_void_p(make(name, 1, token, b"", ctypes.byref(self._kept), 0, 0))
            self._library.fmi2SetupExperiment(
                self._unit, 0, ctypes.c_double(0.0), ctypes.c_double(0.0), 0, ctypes.c_double(0.0)
            )
        else:
            self._kept = _LOGGERS[3](lambda _, status, category, text: self.said.append(f"{status} {text!r}"))
            make = self._library.fmi3InstantiateCoSimulation
            make.restype = ctypes.c_void_p
            no = ctypes.c_bool(False)
            self._unit = ctypes.c_void_p(
                make(name, token, b"", no, no, no, no, None, ctypes.c_size_t(0), None, self._kept, None)
            )

    def start(self, values: Mapping[str, float]) -> int:
        """Set parameters and inputs, and leave the mode of initialisation."""
        status = self.set(values)
        if self.version == 2:
            self._library.fmi2EnterInitializationMode(self._unit)
            return status or int(self._library.fmi2ExitInitializationMode(self._unit))
        zero, no = ctypes.c_double(0.0), ctypes.c_bool(False)
        self._library.fmi3EnterInitializationMode(self._unit, no, zero, zero, no, zero)
        return status or int(self._library.fmi3ExitInitializationMode(self._unit))

    def set(self, values: Mapping[str, float]) -> int:
        """Set variables."""
        references = (ctypes.c_uint * len(values))(*(self.description.references[name] for name in values))
        numbers = (ctypes.c_double * len(values))(*values.values())
        n = ctypes.c_size_t(len(values))
        if self.version == 2:
            return int(self._library.fmi2SetReal(self._unit, references, n, numbers))
        return int(self._library.fmi3SetFloat64(self._unit, references, n, numbers, n))

    def get(self, names: Sequence[str]) -> list[float]:
        """Get variables."""
        references = (ctypes.c_uint * len(names))(*(self.description.references[name] for name in names))
        numbers, n = (ctypes.c_double * len(names))(), ctypes.c_size_t(len(names))
        if self.version == 2:
            status = self._library.fmi2GetReal(self._unit, references, n, numbers)
        else:
            status = self._library.fmi3GetFloat64(self._unit, references, n, numbers, n)
        if status != OK:
            raise ValueError(f"{names}: status {status}")
        return list(numbers)

    def step(self, t: float, h: float) -> int:
        """Do a step."""
        if self.version == 2:
            return int(self._library.fmi2DoStep(self._unit, ctypes.c_double(t), ctypes.c_double(h), 1))
        flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
        last = ctypes.byref(ctypes.c_double())
        arguments = (ctypes.c_double(t), ctypes.c_double(h), ctypes.c_bool(True), *flags, last)
        return int(self._library.fmi3DoStep(self._unit, *arguments))

    def save(self) -> ctypes.c_void_p:
        """Return a copy of the state."""
        state = ctypes.c_void_p()
        get = self._library.fmi2GetFMUstate if self.version == 2 else self._library.fmi3GetFMUState
        get(self._unit, ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        """Go back to a state, and free it."""
        put = self._library.fmi2SetFMUstate if self.version == 2 else self._library.fmi3SetFMUState
        free = self._library.fmi2FreeFMUstate if self.version == 2 else self._library.fmi3FreeFMUState
        put(self._unit, state)
        free(self._unit, ctypes.byref(state))

    def reset(self) -> None:
        """Begin anew."""
        (self._library.fmi2Reset if self.version == 2 else self._library.fmi3Reset)(self._unit)

    def close(self) -> None:
        """Free the instance."""
        (self._library.fmi2FreeInstance if self.version == 2 else self._library.fmi3FreeInstance)(self._unit)
