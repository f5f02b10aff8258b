"""Vehicles: records, files, catalog, thrusters, and the dynamics of a vehicle."""

from towtank.vehicle.checks import doubts, faults
from towtank.vehicle.configurations import Configuration, Configurations
from towtank.vehicle.differences import Difference, Differences, differences
from towtank.vehicle.files import (
    AnyVehicle,
    VehicleWarning,
    catalog_names,
    catalog_text,
    curve_text,
    load_vehicle,
    parse_vehicle,
    save_vehicle,
    vehicle_of,
    vehicle_text,
)
from towtank.vehicle.motion import forward_dynamics, inverse_dynamics
from towtank.vehicle.names import COEFFICIENTS, FORWARD_SPEED, HYDRODYNAMIC, RESTORING, describe, index, mirror, unit
from towtank.vehicle.posterior import Posterior
from towtank.vehicle.records import Buoyancy, Coefficient, Provenance, Restoring, RigidBody, Thruster
from towtank.vehicle.thrusters.bench import Bench, read_bench
from towtank.vehicle.thrusters.curves import Curve, PolynomialCurve, QuadraticCurve, TableCurve, Voltage, force_range
from towtank.vehicle.thrusters.curves import command as curve_command
from towtank.vehicle.thrusters.curves import force as curve_force
from towtank.vehicle.thrusters.fit import ThrusterFit, fit_bench, fit_thruster
from towtank.vehicle.thrusters.wrench import (
    allocatable_axes,
    allocate,
    configuration_matrix,
    thruster_commands,
    thruster_forces,
    thruster_wrench,
)
from towtank.vehicle.vehicle import Vehicle

__all__ = [
    "COEFFICIENTS",
    "FORWARD_SPEED",
    "HYDRODYNAMIC",
    "RESTORING",
    "AnyVehicle",
    "Bench",
    "Buoyancy",
    "Coefficient",
    "Configuration",
    "Configurations",
    "Curve",
    "Difference",
    "Differences",
    "PolynomialCurve",
    "Posterior",
    "Provenance",
    "QuadraticCurve",
    "Restoring",
    "RigidBody",
    "TableCurve",
    "Thruster",
    "ThrusterFit",
    "Vehicle",
    "VehicleWarning",
    "Voltage",
    "allocatable_axes",
    "allocate",
    "catalog_names",
    "catalog_text",
    "configuration_matrix",
    "curve_command",
    "curve_force",
    "curve_text",
    "describe",
    "differences",
    "doubts",
    "faults",
    "fit_bench",
    "fit_thruster",
    "force_range",
    "forward_dynamics",
    "index",
    "inverse_dynamics",
    "load_vehicle",
    "mirror",
    "parse_vehicle",
    "read_bench",
    "save_vehicle",
    "thruster_commands",
    "thruster_forces",
    "thruster_wrench",
    "unit",
    "vehicle_of",
    "vehicle_text",
]
