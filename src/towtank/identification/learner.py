"""The learner: one sample at a time, or a whole recording in one call, with the same result.

On disk it is plain arrays in one `.npz` file, so that a session goes on where it was cut off. Nothing in the file is
executed when it is read. It belongs to one vehicle, whose numbers are checked, and to one version of the layout.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.identification.posterior.estimate import Estimate
from towtank.methods import STREAMING_METHODS
from towtank.outputs import write_atomically
from towtank.recording import Recording
from towtank.recording.event import Event
from towtank.recording.grids.free_motion import free_parts
from towtank.recording.standard import SAMPLE
from towtank.vehicle import AnyVehicle, Vehicle, vehicle_of

if TYPE_CHECKING:
    from towtank.identification.posterior.assembly import Current

__all__ = ["Learner", "sample_vector"]

_VERSION = 17  # of the layout on disk

T = TypeVar("T")


class Learner:
    """Learns a vehicle's coefficients from its commands and its motion, sample by sample.

    Args:
        vehicle: what is known: rigid body, thrusters, and values for whatever is not learned; or its name or path.
        method: "joint": one Kalman filter over motion, disturbance and all coefficients, see `JointLearner`. "paper":
            filtered regressors, one axis at a time, recursive least squares, see `PaperLearner`.
        settings: of the method.

    Samples go to `update` with all that belongs to one instant; times may be irregular and sensors of several rates.
    Out-of-order samples are passed over. What is handed in is neither kept nor changed; what is read changes nothing.

    Attributes:
        vehicle: what it was given. method: one of `STREAMING_METHODS`.
        keeps_checkpoints: whether `save` and `to_arrays` can be asked for.

    Raises:
        InputError: an unknown method, name or setting.
    """

    vehicle: Vehicle
    method: str
    keeps_checkpoints = False

    def __new__(cls, vehicle: AnyVehicle | None = None, method: str = "joint", **settings: Any) -> Learner:
        """Return a learner of the method asked for; a pickle makes one of its class without arguments."""
        if cls is not Learner:
            return super().__new__(cls)
        return super().__new__(_class_of(method))

    def __init__(self, vehicle: AnyVehicle, method: str = "joint", **settings: Any) -> None:
        raise NotImplementedError

    def update(
        self,
        t: float,
        *,
        pose: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        water_velocity: ArrayLike | None = None,
        commands: ArrayLike | None = None,
        wrench: ArrayLike | None = None,
        voltage: float | None = None,
    ) -> bool:
        """Take the sample of time t [s]; True where something was learned from the interval that it ends.

        Args:
            pose: x y z [m, NED] phi theta psi [rad] (6,). velocity: u v w p q r (6,), body FRD.
            acceleration: specific force (3,) [m/s^2], body FRD. NaN, or None for the whole, where not measured.
            water_velocity: u_w v_w w_w (3,) [m/s] through the water, body FRD.
            commands: one per thruster, in force from t on; wrench: X Y Z K M N, likewise. None: unchanged.
            voltage: of the supply, where the thrusters' curves depend on it.
        """
        given = {"pose": pose, "velocity": velocity, "acceleration": acceleration, "water_velocity": water_velocity}
        z = np.concatenate([sample_vector(given[name], len(names), name) for name, names in SAMPLE.items()])
        return self._take(float(t), z, commands, wrench, voltage)

    def _take(
        self, t: float, z: Array, commands: ArrayLike | None, wrench: ArrayLike | None, voltage: float | None
    ) -> bool:
        """Take the row z (18,), in the order of `MEASURED`; see `update`."""
        raise NotImplementedError

    def run(self, recording: Recording, *, keep_all: bool = False) -> int:
        """Take a whole recording; return how many intervals were learned from.

        Several recordings may follow each other; each begins a new stretch, and what was learned stays.

        Args:
            keep_all: also what shows no vehicle that moves freely in water under known commands.

        Raises:
            InputError: there is no motion, nothing counts, or its thrusters are not the vehicle's.
        """
        parts = [recording] if keep_all else free_parts(recording, self.vehicle)
        return sum(self._run(part) for part in parts)

    def _run(self, recording: Recording) -> int:
        raise NotImplementedError

    def restart(self) -> None:
        """Begin a new stretch of samples whose times owe nothing to the last one's; what was learned stays."""
        raise NotImplementedError

    def settle(self) -> None:
        """Wait for what runs in the background, if anything does; `estimate` is then of every sample taken."""

    def to_arrays(self) -> dict[str, Any]:
        """Return all that it knows as arrays by name, for `from_arrays`; what runs in the background is not waited for.

        Raises:
            InputError: the method keeps no checkpoint.
        """
        raise InputError(f'method "{self.method}" keeps no checkpoint; "joint" does')

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, Any],
        vehicle: AnyVehicle,
        *,
        prior: Vehicle | None = None,
        background: bool = False,
        known: Mapping[str, Vehicle] | None = None,
    ) -> Learner:
        """Return a learner of this class that goes on as the one did that handed out the arrays; see `load`."""
        raise InputError(f'{cls.__name__} keeps no checkpoint; method "joint" does')

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a checkpoint, whole or not at all, from which `Learner.load` goes on; it goes on learning.

        Raises:
            InputError: the folder cannot be written, or the method keeps no checkpoint.
        """
        _write_checkpoint(path, self.method, self.vehicle, self.to_arrays())

    @staticmethod
    def load(
        path: str | os.PathLike[str],
        vehicle: AnyVehicle,
        *,
        prior: Vehicle | None = None,
        background: bool = False,
        known: Mapping[str, Vehicle] | None = None,
    ) -> Learner:
        """Return the learner that `save` wrote; it goes on as if it had never stopped.

        Args:
            vehicle: the one that it was made with. prior, background, known: as of `JointLearner`.

        Raises:
            InputError: the file is missing, damaged, of another version, or of another vehicle.
        """

        def restored(method: str, arrays: Mapping[str, Any]) -> Learner:
            return _class_of(method).from_arrays(arrays, vehicle, prior=prior, background=background, known=known)

        return _read_checkpoint(path, vehicle_of(vehicle), restored)

    # -- what is known by now; a method that has none of something says so by the value named

    @property
    def estimate(self) -> Estimate:
        """What has been learned so far."""
        raise NotImplementedError

    @property
    def delay(self) -> float:
        """From input to force [s]; NaN where the method learns none."""
        return math.nan

    @property
    def lag(self) -> float:
        """Time constant of the thrusters [s]; NaN where none is learned."""
        return math.nan

    @property
    def gains(self) -> dict[str, tuple[float, float]]:
        """Gain of each thruster and its deviation, as multiples of its curve; empty where none is learned."""
        return {}

    @property
    def latency(self) -> dict[str, tuple[float, float]]:
        """Latency of sensors and its deviation [s]; empty where none is learned."""
        return {}

    @property
    def noise(self) -> Array | None:
        """Noise (18,) of each sample of x y z phi theta psi u v w p q r ax ay az; None where it is not estimated."""
        return None

    @property
    def disturbance(self) -> Array | None:
        """Level (6,) [N, N m], body FRD, of the random force beside the model; None where it is not estimated."""
        return None

    @property
    def current(self) -> Current | None:
        """Of the water; None where it is not estimated, or nothing has been seen."""
        return None

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is to be said of what was learned, in sentences."""
        return ()

    @property
    def likely(self) -> dict[str, float]:
        """Known configurations and how probable each is, since the last change; empty where none is compared."""
        return {}

    @property
    def events(self) -> tuple[Event, ...]:
        """What happened to the vehicle, as far as it was noticed, in the order of noticing."""
        return ()

    def model(self) -> Vehicle:
        """Return the vehicle with everything identified so far put in."""
        raise NotImplementedError


def _class_of(method: str) -> type[Learner]:
    """Return the class of a method; InputError where there is none."""
    if method not in STREAMING_METHODS:
        known = ", ".join(STREAMING_METHODS)
        raise InputError(f'method: found "{method}", expected one of {known}{nearest(method, STREAMING_METHODS)}')
    if method == "joint":
        from towtank.identification.online.joint import JointLearner

        return JointLearner
    from towtank.identification.online.least_squares import PaperLearner

    return PaperLearner


def sample_vector(values: ArrayLike | None, n: int, name: str) -> Array:
    """Return a sample's numbers (n,), NaN where there are none; InputError where there are others."""
    if values is None:
        return np.full(n, np.nan)
    vector = np.ascontiguousarray(values, dtype=np.float64)
    if vector.shape != (n,):
        raise InputError(f"{name}: found shape {vector.shape}, expected ({n},)")
    return vector


def _write_checkpoint(path: str | os.PathLike[str], method: str, vehicle: Vehicle, arrays: Mapping[str, Any]) -> None:
    """Write what a learner of a method hands out, whole or not at all. InputError: the folder cannot be written."""
    about = {"version": _VERSION, "method": method, "vehicle": vehicle.name}
    head = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)

    def write(file: BinaryIO) -> None:
        np.savez(file, about=head, parameters=np.array(vehicle.parameters), **arrays)

    write_atomically(path, write)


def _read_checkpoint(
    path: str | os.PathLike[str], vehicle: Vehicle, restored: Callable[[str, Mapping[str, Any]], T]
) -> T:
    """Return what `restored` makes of the method and the arrays in a file.

    Raises:
        InputError: the file is missing, damaged, of another version, or of another vehicle.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(arrays["about"].tobytes())
        if about["version"] != _VERSION:
            raise InputError(f"{path}: found a checkpoint of version {about['version']}, expected {_VERSION}")
        if not np.array_equal(arrays["parameters"], np.array(vehicle.parameters)):
            raise InputError(
                f'{path}: this checkpoint was made with other numbers of the vehicle "{about["vehicle"]}"; give the '
                "vehicle file that the session began with"
            )
        return restored(about["method"], arrays)
    except FileNotFoundError:
        raise InputError(f"{path}: no such checkpoint") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a checkpoint, or a damaged one ({error})") from error
