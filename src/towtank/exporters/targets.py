"""The targets of `towtank export`, one table.

A target is a module with two functions:

    kept(request) -> Kept                              the vehicle as the target's simulator moves it, and remarks
    written(request, heading) -> dict[str, bytes]      the files by their names; the same bytes for the same request

Modules are imported on use.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Protocol, cast

from towtank.errors import InputError, nearest
from towtank.exporters.heading import Heading
from towtank.exporters.request import Kept, Request

__all__ = ["TARGETS", "Target", "Writer", "target_named"]


class Writer(Protocol):
    """What a target's module has."""

    def kept(self, request: Request) -> Kept:
        """Return what the target keeps of the vehicle. Raises InputError where it cannot be exported to it at all."""

    def written(self, request: Request, heading: Heading) -> dict[str, bytes]:
        """Return the files by their names, whose first or last comment is the heading."""


@dataclass(frozen=True)
class Target:
    """A target.

    Attributes:
        name: as `--to` takes it. summary: what it is for. writes: the files, in words.
        versions: of the target's format that can be written, the usual one first.
        suffix: of the single file that is written; empty where it is a folder of files.
        options: switches that only some targets have.
        ending: of the file's name where none is given, before the suffix.
    """

    name: str
    module: str
    summary: str
    writes: str
    versions: tuple[str, ...]
    suffix: str = ""
    options: tuple[str, ...] = ()
    ending: str = ""

    @property
    def writer(self) -> Writer:
        """The target's module."""
        return cast(Writer, importlib.import_module(f"towtank.exporters.{self.module}"))


TARGETS: tuple[Target, ...] = (
    Target(
        "gz-sim",
        "simulators.gz_sim",
        "Gazebo (gz-sim), with DART or another engine",
        "model.sdf, model.config, world.sdf",
        ("1.10", "1.11", "1.12"),
        options=("engine", "with-ardupilot"),
    ),
    Target(
        "urdf-hydrodynamics",
        "simulators.urdf",
        "blue and auv_controllers (ROS 2)",
        "a URDF, thrusters.yaml",
        ("2026",),
    ),
    Target(
        "c",
        "programs.c99",
        "any program in C or C++: firmware, controllers",
        "one C99 header",
        ("c99",),
        ".h",
        ("float",),
    ),
    Target(
        "fmu",
        "programs.fmu",
        "Simulink, OpenModelica, co-simulation",
        "an FMU, sources and binary",
        ("2.0", "3.0"),
        ".fmu",
    ),
    Target(
        "python",
        "programs.python_file",
        "NumPy, and Fossen's Python Vehicle Simulator",
        "one Python file",
        ("numpy",),
        ".py",
    ),
    Target(
        "mss",
        "programs.mss",
        "MATLAB, GNU Octave, Marine Systems Simulator",
        "one function file",
        ("octave",),
        ".m",
    ),
    Target(
        "matlab",
        "programs.matlab",
        "MATLAB: matrices, covariance, linear model",
        "one .mat file",
        ("5",),
        ".mat",
    ),
    Target(
        "state-space",
        "programs.state_space",
        "python-control: the model to first order",
        "one Python file",
        ("python-control",),
        ".py",
        ending="_linear",
    ),
    Target(
        "mujoco",
        "simulators.mujoco",
        "MuJoCo: learning to control, manipulation",
        "model.xml and a NumPy module",
        ("4.0",),
    ),
    Target(
        "casadi",
        "programs.symbolic",
        "CasADi: model-predictive control, trajectories",
        "one Python module",
        ("3.8",),
        ".py",
        ending="_casadi",
    ),
)


def target_named(name: str) -> Target:
    """Return the target of this name. Raises InputError for another one."""
    names = [each.name for each in TARGETS]
    if name not in names:
        raise InputError(f'--to: found "{name}"{nearest(name, names)}; there are {", ".join(names)}')
    return next(each for each in TARGETS if each.name == name)
