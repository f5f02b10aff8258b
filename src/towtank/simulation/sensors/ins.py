"""An inertial navigation set: IMU with bias and noise, DVL, depth, and attitude, each at its own rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.channel import Channel, read_only
from towtank.recording.standard import ACCELERATIONS, EULER
from towtank.simulation.inputs import stream
from towtank.simulation.motion import Motion
from towtank.simulation.sensors.sensor import (
    Place,
    channels,
    require_non_negative,
    require_places,
    require_positive,
    sampled,
)

__all__ = ["Ins"]


@dataclass(frozen=True)
class Ins:
    """IMU (p q r, ax ay az), DVL (u v w over ground), depth (z), attitude (phi theta psi), at the body origin.

    Attributes:
        imu_rate, dvl_rate, depth_rate, attitude_rate: [Hz], at most once a step.
        gyro_noise, gyro_bias: standard deviation of the white noise per sample and of the constant bias [rad/s].
        accelerometer_noise, accelerometer_bias: the same [m/s^2].
        dvl_noise, depth_noise: white noise [m/s], [m].
        attitude_noise_mrad, heading_noise_mrad: white noise on roll and pitch, and on yaw [mrad].
        imu_place, dvl_place: where the accelerometer and the DVL are (3,) [m], body FRD.

    A bias is drawn once per run, from the seed.

    Raises:
        InputError: a number is out of range.
    """

    imu_rate: float = 100.0
    gyro_noise: float = 2e-3
    gyro_bias: float = 1e-3
    accelerometer_noise: float = 0.02
    accelerometer_bias: float = 0.03
    dvl_rate: float = 8.0
    dvl_noise: float = 5e-3
    depth_rate: float = 10.0
    depth_noise: float = 5e-3
    attitude_rate: float = 50.0
    attitude_noise_mrad: float = 2.0
    heading_noise_mrad: float = 5.0
    imu_place: Place = (0.0, 0.0, 0.0)
    dvl_place: Place = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        rates = ("imu_rate", "dvl_rate", "depth_rate", "attitude_rate")
        require_positive(self, *rates)
        places = ("imu_place", "dvl_place")
        require_non_negative(self, *(name for name in self.__dataclass_fields__ if name not in (*rates, *places)))
        require_places(self, *places)

    def observe(self, motion: Motion, seed: int) -> list[Channel]:
        """Return phi theta psi, z, u v w, p q r, ax ay az."""
        imu = sampled(motion, self.imu_rate)
        dvl = sampled(motion, self.dvl_rate)
        depth = sampled(motion, self.depth_rate)
        attitude = sampled(motion, self.attitude_rate)
        tilt, heading = 1e-3 * self.attitude_noise_mrad, 1e-3 * self.heading_noise_mrad
        angles = _noisy(motion.eta[attitude, 3:], np.array([tilt, tilt, heading]), 0.0, seed, "attitude")
        z = _noisy(motion.eta[depth, 2:3], self.depth_noise, 0.0, seed, "depth")
        v = motion.nu[dvl, :3] + np.cross(motion.nu[dvl, 3:], self.dvl_place)
        v = _noisy(v, self.dvl_noise, 0.0, seed, "dvl")
        omega = _noisy(motion.nu[imu, 3:], self.gyro_noise, self.gyro_bias, seed, "gyro")
        force = motion.specific_force(self.imu_place)[imu]
        force = _noisy(force, self.accelerometer_noise, self.accelerometer_bias, seed, "accelerometer")
        t_imu = read_only(motion.t[imu])
        return [
            *channels(EULER, read_only(motion.t[attitude]), angles),
            *channels(("z",), read_only(motion.t[depth]), z),
            *channels(("u", "v", "w"), read_only(motion.t[dvl]), v),
            *channels(("p", "q", "r"), t_imu, omega),
            *channels(ACCELERATIONS, t_imu, force),
        ]


def _noisy(true: Array, noise: Array | float, bias: float, seed: int, name: str) -> Array:
    """Return `true` (n, k) with white noise and one constant random bias per column."""
    white = noise * stream(seed, "ins", name, "noise").standard_normal(true.shape)
    constant = bias * stream(seed, "ins", name, "bias").standard_normal(true.shape[1])
    noisy: Array = true + white + constant
    return noisy
