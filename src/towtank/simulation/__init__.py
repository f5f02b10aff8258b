"""Simulated vehicles: motion, sensors, disturbances, and the manoeuvres that excite them."""

from towtank.simulation.batch import Batch, simulate_batch
from towtank.simulation.excitation import AXES, available_rows, usual_amplitudes
from towtank.simulation.inputs import stream
from towtank.simulation.manoeuvres import MANOEUVRES, BuiltIn, Manoeuvre, manoeuvre, manoeuvre_from_recording
from towtank.simulation.motion import Motion
from towtank.simulation.sensors.ins import Ins
from towtank.simulation.sensors.mocap import Mocap
from towtank.simulation.sensors.presets import SENSORS
from towtank.simulation.sensors.sensor import Perfect, Sensors, Together
from towtank.simulation.sensors.water_track import WaterTrack
from towtank.simulation.signals import FORMS
from towtank.simulation.simulate import Progress, simulate
from towtank.simulation.water import OrnsteinUhlenbeck, RisingCurrent, Waves

__all__ = [
    "AXES",
    "FORMS",
    "MANOEUVRES",
    "SENSORS",
    "Batch",
    "BuiltIn",
    "Ins",
    "Manoeuvre",
    "Mocap",
    "Motion",
    "OrnsteinUhlenbeck",
    "Perfect",
    "Progress",
    "RisingCurrent",
    "Sensors",
    "Together",
    "WaterTrack",
    "Waves",
    "available_rows",
    "manoeuvre",
    "manoeuvre_from_recording",
    "simulate",
    "simulate_batch",
    "stream",
    "usual_amplitudes",
]
