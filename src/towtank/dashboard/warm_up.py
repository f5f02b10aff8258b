"""Everything that the page computes with, compiled before a session begins."""

from __future__ import annotations

import numpy as np

from towtank.dashboard.motion import Motion
from towtank.dashboard.prediction import free_run
from towtank.identification import Learner
from towtank.vehicle import Vehicle

__all__ = ["warm_up"]


def warm_up(vehicle: Vehicle) -> None:
    """Run two seconds of a vehicle at rest through the free run."""
    motion = Motion(vehicle)
    motion.add([(0.02 * k, {"pose": np.zeros(6), "wrench": np.zeros(6)}) for k in range(100)])
    free_run(vehicle, Learner(vehicle, method="paper").estimate, 0.0, *motion.last(2.0))
