"""Target `gz-sim`: Gazebo, as a model's folder with a world to try it in.

With DART, the usual engine, the added mass goes into the link's inertia (`fluid_added_mass`), full and with its
Coriolis forces. Other engines do not know that tag: there the Hydrodynamics plugin makes added mass out of the
velocity's difference between two steps, and its own Coriolis matrix has a wrong sign in places, so that it is switched
off and written exactly as bilinear damping instead.

Frames: the link is FLU with its origin where the vehicle's body origin is; T F(T nu), see `towtank.exporters.frames`.
Sources: gz-sim Hydrodynamics.cc, Thruster.cc, Buoyancy.cc; gz-physics dartsim SDFFeatures.cc, SimulationFeatures.cc.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from xml.sax.saxutils import escape

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.errors import InputError, nearest
from towtank.exporters.frames import folded, parallel_axes, turned_bilinear, turned_matrix, turned_vector
from towtank.exporters.heading import Heading
from towtank.exporters.request import Kept, Request, rounded, stem_of, with_plain_buoyancy
from towtank.exporters.templates import filled, template
from towtank.vehicle import PolynomialCurve, Thruster, Vehicle, curve_force, force_range, index
from towtank.vehicle.matrices import GRAVITY, damping_matrices, matrix_of

__all__ = ["DENSITY", "PROPELLER_INERTIA", "PROPELLER_MASS", "bilinear_of_added_mass", "kept", "written"]

DENSITY = 1000.0  # kg/m^3, of the water in Gazebo's worlds
PROPELLER_MASS, PROPELLER_INERTIA = 1e-3, 1e-7  # kg, kg m^2 about any axis: as little as engines take
_ENGINES = {"dart": "dartsim", "bullet": "bullet-featherstone", "mujoco": "mujoco"}
_FORCES, _VELOCITIES, _ADDED = "xyzkmn", "UVWPQR", "xyzpqr"
_MOST_THRUST = 1000.0  # N, where neither file nor Gazebo says
_FASTEST = 300.0  # rad/s of a propeller at full thrust; seen only, the thrust is commanded in N
_DIAMETER = 0.076  # m
_SERVO = (1100.0, 1900.0)  # us, of commands that are not in us themselves


def kept(request: Request) -> Kept:
    """Return what Gazebo keeps: no constant forces, no loss by inflow, thrusters commanded in N without lag."""
    vehicle = rounded(with_plain_buoyancy(request.vehicle))
    engine = _engine(request)
    _require_solid(vehicle)
    remarks = []
    if engine != "dart":
        _require_stable(vehicle, engine)
        remarks.append(f"engine {engine}: added mass acts one step late, on the difference of two velocities")
    values = {
        name: each for name, each in vehicle.hydrodynamics.items() if index(name)[0] not in ("constant", "inflow")
    }
    curves = [_commanded(each) for each in vehicle.thrusters]
    if any(a.curve != b.curve for a, b in zip(vehicle.thrusters, curves, strict=True)):
        remarks.append("curves of the thrusters: absent, Gazebo takes their forces in N (cmd_thrust)")
    if "with-ardupilot" in request.options:
        remarks.append(f"ArduPilot's channels are straight lines, up to {_worst_line(vehicle)} N off the curves")
    lifted = vehicle.model_copy(update={"hydrodynamics": values, "thrusters": tuple(curves), "command_delay": 0.0})
    return Kept(lifted, tuple(remarks))


def _engine(request: Request) -> str:
    engine = str(request.options.get("engine", "dart"))
    if engine not in _ENGINES:
        raise InputError(f'--engine: found "{engine}"{nearest(engine, _ENGINES)}; there are {", ".join(_ENGINES)}')
    return engine


def _require_stable(vehicle: Vehicle, engine: str) -> None:
    """Refuse added mass beyond the body's own where it acts a step late: the error of a step would grow in the next."""
    ratio = np.linalg.eigvals(np.linalg.solve(vehicle.rigid_body_matrix, vehicle.added_mass_matrix))
    worst = float(np.abs(ratio).max())
    if worst >= 1.0:
        raise InputError(
            f"{vehicle.name}: the engine {engine} takes added mass a step late, which diverges where it is more than"
            f" the body's own; found {short(worst)} times as much, expected less than 1; use the engine dart"
        )


def _commanded(thruster: Thruster) -> Thruster:
    """Return a thruster that is commanded in N; one that is already, with its dead band."""
    low, high = (float(each) for each in _range(thruster))
    if not low < high:
        raise InputError(
            f"{thruster.name}: its curve gives no force at any command, so that Gazebo has no range for it; mend the"
            " curve or take the thruster out of the file"
        )
    plain = PolynomialCurve(coefficients=(0.0, 1.0), limits=(low, high))
    same = plain.model_copy(update={"dead_band": thruster.curve.dead_band})
    curve = same if thruster.curve == same and thruster.gain == 1.0 else plain
    return thruster.model_copy(update={"curve": curve, "gain": 1.0, "time_constant": 0.0})


def _range(thruster: Thruster) -> Array:
    ends = np.array(force_range(thruster.curve)) * thruster.gain
    return np.where(np.isfinite(ends), ends, np.array([-_MOST_THRUST, _MOST_THRUST]))


# -- files


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return model.sdf, model.config and world.sdf."""
    vehicle, engine, model = kept(request).vehicle, _engine(request), stem_of(request.vehicle)
    piloted = "with-ardupilot" in request.options
    common = {"version": request.version, "model": model, "heading": heading.xml}
    mass, centre, tensor = _base(vehicle)
    values = {
        **common,
        "mass": _number(mass),
        "centre": _row(turned_vector(centre)),
        "inertia": _tags(_moments(turned_matrix(tensor)), 10),
        "added": _added(vehicle) if engine == "dart" else "",
        "hydrodynamics": _tags(dict(_hydrodynamics(vehicle, plugin=engine != "dart")), 6),
        "box": _box(vehicle),
        "imu": _IMU if piloted else "",
        "propellers": "".join(_propeller(each) for each in vehicle.thrusters),
        "thrusters": "".join(_plugin(each, model) for each in vehicle.thrusters),
        "ardupilot": _ardupilot(request.vehicle, model) if piloted else "",
    }
    text = filled(template("gz_model.sdf"), values)
    body = text.partition(f'<sdf version="{request.version}">\n')[2].rpartition("</sdf>")[0]
    world = {
        **common,
        "engine": f"gz-physics-{_ENGINES[engine]}-plugin",
        "sensors": _IMU_SYSTEM if piloted else "",
        "body": textwrap.indent(body, "  "),
    }
    config = {**common, "description": escape(f"{heading.vehicle}, {heading.title}")}
    return {
        "model.sdf": text.encode(),
        "model.config": filled(template("gz_model.config"), config).encode(),
        "world.sdf": filled(template("gz_world.sdf"), world).encode(),
    }


_IMU = """      <sensor name="imu_sensor" type="imu">
        <pose degrees="true">0 0 0 180 0 0</pose>
        <always_on>1</always_on>
        <update_rate>1000</update_rate>
      </sensor>
"""
_IMU_SYSTEM = '    <plugin filename="gz-sim-imu-system" name="gz::sim::systems::Imu"/>\n'


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


def _row(values: Array) -> str:
    return " ".join(_number(each) for each in values)


def _tags(values: dict[str, float], blanks: int) -> str:
    texts = {name: "true" if value is True else _number(value) for name, value in values.items()}
    return "\n".join(f"{' ' * blanks}<{name}>{text}</{name}>" for name, text in texts.items())


def _moments(tensor: Array) -> dict[str, float]:
    return {f"i{'xyz'[i]}{'xyz'[j]}": float(tensor[i, j]) for i in range(3) for j in range(i, 3)}


def _base(vehicle: Vehicle) -> tuple[float, Array, Array]:
    """Return mass, centre of gravity and inertia about it of the vehicle without its propellers, in FRD."""
    body, places = vehicle.rigid_body, [np.array(each.position) for each in vehicle.thrusters]
    r_G = np.array(body.centre_of_gravity)
    mass = body.mass - PROPELLER_MASS * len(places)
    if not places:
        return mass, r_G, body.tensor
    if mass <= 0.5 * body.mass:
        raise InputError(f"{vehicle.name}: found a mass of {body.mass:g} kg, expected more than its propellers' links")
    centre = (body.mass * r_G - PROPELLER_MASS * sum(places)) / mass
    tensor = body.tensor - parallel_axes(mass, centre - r_G)
    for place in places:
        tensor = tensor - PROPELLER_INERTIA * np.eye(3) - parallel_axes(PROPELLER_MASS, place - r_G)
    return mass, centre, tensor


def _require_solid(vehicle: Vehicle) -> None:
    """Refuse an inertia that no distribution of mass has: Gazebo does not load such a link."""
    moments = np.linalg.eigvalsh(_base(vehicle)[2])
    if moments[0] <= 0.0 or moments[0] + moments[1] < (1.0 - 1e-6) * moments[2]:
        found = ", ".join(f"{each:.4g}" for each in moments)
        raise InputError(
            f"{vehicle.name}: Gazebo loads no link with moments of inertia {found} kg m^2 (without propellers),"
            " expected each above 0 and none above the sum of the others; mend rigid_body.inertia"
        )


def _added(vehicle: Vehicle) -> str:
    M = turned_matrix(vehicle.added_mass_matrix)
    tags = {_ADDED[i] + _ADDED[j]: float(M[i, j]) for i in range(6) for j in range(i, 6)}
    return f"        <fluid_added_mass>\n{_tags(tags, 10)}\n        </fluid_added_mass>\n"


def _hydrodynamics(vehicle: Vehicle, *, plugin: bool) -> Iterator[tuple[str, float]]:
    """Yield the plugin's tags, those that are not zero; with `plugin` those of added mass as well."""
    values = {name: each.value for name, each in vehicle.hydrodynamics.items()}
    linear, quadratic = (turned_matrix(each) for each in damping_matrices(values))
    terms = np.zeros((6, 6, 6))
    forward = matrix_of("forward", values)
    terms[:, :, 0] += forward
    for name, value in values.items():
        kind, i, _ = index(name)
        if kind == "asymmetric":
            terms[i, i, i] += value
    if plugin:
        yield from _mass_tags(vehicle)
        terms += bilinear_of_added_mass(vehicle.added_mass_matrix)
    bilinear = turned_bilinear(terms)
    for i in range(6):
        for j in range(6):
            tag = _FORCES[i] + _VELOCITIES[j]
            if linear[i, j] != 0.0:
                yield tag, float(linear[i, j])
            if quadratic[i, j] != 0.0:
                yield f"{tag}abs{_VELOCITIES[j]}", float(quadratic[i, j])
            for k in range(6):
                if bilinear[i, j, k] != 0.0:
                    yield tag + _VELOCITIES[k], float(bilinear[i, j, k])


def _mass_tags(vehicle: Vehicle) -> Iterator[tuple[str, float]]:
    M = turned_matrix(vehicle.added_mass_matrix)
    yield "disable_coriolis", True
    for i in range(6):
        for j in range(6):
            if M[i, j] != 0.0:
                yield f"{_FORCES[i]}Dot{_VELOCITIES[j]}", -float(M[i, j])


def bilinear_of_added_mass(M_A: Array) -> Array:
    """Return a_ijk (6, 6, 6), j <= k, with -C_A(nu) nu = a_ijk nu_j nu_k (Fossen 2011, eq. 6.43)."""
    terms = np.zeros((6, 6, 6))
    for row in range(3):
        a, b = (row + 1) % 3, (row + 2) % 3
        for k in range(6):
            # force: p x omega; moment: p x v + h x omega, with the momenta p = M_A[:3] nu and h = M_A[3:] nu
            for i, momentum, velocity in ((row, 0, 3), (3 + row, 0, 0), (3 + row, 3, 3)):
                terms[i, k, velocity + b] += M_A[momentum + a, k]
                terms[i, k, velocity + a] -= M_A[momentum + b, k]
    return folded(terms)


def _box(vehicle: Vehicle) -> str:
    """Return the box that displaces the water, as a collision and to be seen, its shape that of the inertia."""
    volume = vehicle.buoyant_force / (DENSITY * GRAVITY)
    if volume <= 0.0:
        return ""
    I = np.diag(vehicle.rigid_body.tensor)
    squares = np.array([I[1] + I[2] - I[0], I[2] + I[0] - I[1], I[0] + I[1] - I[2]])
    sides = np.sqrt(squares) if squares.min() > 1e-3 * squares.max() else np.ones(3)
    sides = np.round(sides * (volume / sides.prod()) ** (1.0 / 3.0), 6)
    size = _row(np.array([sides[0], sides[1], volume / (sides[0] * sides[1])]))
    pose = f"<pose>{_row(turned_vector(vehicle.buoyancy.centre))} 0 0 0</pose>"
    shape = f"<geometry><box><size>{size}</size></box></geometry>"
    look = "<material><diffuse>0.1 0.4 0.7 1</diffuse><ambient>0.1 0.4 0.7 1</ambient></material>"
    return (
        "      <!-- Its volume and centre are the buoyancy. -->\n"
        f'      <collision name="displaced">\n        {pose}\n        {shape}\n      </collision>\n'
        f'      <visual name="hull">\n        {pose}\n        {shape}\n        {look}\n      </visual>\n'
    )


def _propeller(thruster: Thruster) -> str:
    inertia = {f"i{'xyz'[i]}{'xyz'[j]}": PROPELLER_INERTIA if i == j else 0.0 for i in range(3) for j in range(i, 3)}
    return f"""
    <link name="{thruster.name}">
      <pose>{_row(turned_vector(thruster.position))} 0 0 0</pose>
      <inertial>
        <mass>{_number(PROPELLER_MASS)}</mass>
        <inertia>
{_tags(inertia, 10)}
        </inertia>
      </inertial>
    </link>
    <joint name="{thruster.name}_joint" type="revolute">
      <parent>base_link</parent>
      <child>{thruster.name}</child>
      <axis><xyz>{_row(turned_vector(thruster.direction))}</xyz></axis>
    </joint>
"""


def _plugin(thruster: Thruster, model: str) -> str:
    low, high = _range(thruster)
    coefficient = max(-low, high) / (DENSITY * _DIAMETER**4 * _FASTEST**2)
    dead_band = thruster.curve.dead_band
    return f"""
    <plugin filename="gz-sim-thruster-system" name="gz::sim::systems::Thruster">
      <namespace>{model}</namespace>
      <joint_name>{thruster.name}_joint</joint_name>
      <!-- The thrust is what is commanded, in N; coefficient and diameter say only how fast the propeller is seen. -->
      <min_thrust_cmd>{_number(low)}</min_thrust_cmd>
      <max_thrust_cmd>{_number(high)}</max_thrust_cmd>
{f"      <deadband>{_number(dead_band)}</deadband>" + chr(10) if dead_band else ""}\
      <thrust_coefficient>{coefficient:.6g}</thrust_coefficient>
      <propeller_diameter>{_DIAMETER}</propeller_diameter>
      <fluid_density>{_number(DENSITY)}</fluid_density>
      <velocity_control>true</velocity_control>
    </plugin>
"""


# -- ArduPilot's channels


def _line(thruster: Thruster) -> tuple[float, float, float, float, float]:
    """Return ends of the servo [us], offset and multiplier of a channel, and its largest error [N] off the curve."""
    curve = thruster.curve
    low, high = (curve.rest - 1.0, curve.rest + 1.0) if curve.limits is None else curve.limits
    commands = np.linspace(low, high, 401)
    forces = np.asarray(curve_force(curve, commands)) * thruster.gain
    raw = (commands - curve.rest) / (high - low)
    slope = float(raw @ forces / (raw @ raw))
    ends = (low, high) if high - low > 100.0 else _SERVO
    return *ends, -(curve.rest - low) / (high - low), slope, float(np.abs(slope * raw - forces).max())


def _worst_line(vehicle: Vehicle) -> str:
    return short(max((_line(each)[4] for each in vehicle.thrusters), default=0.0), 2)


def _ardupilot(vehicle: Vehicle, model: str) -> str:
    channels = []
    for k, thruster in enumerate(vehicle.thrusters):
        low, high, offset, multiplier, _ = _line(thruster)
        tags = {"servo_min": low, "servo_max": high, "offset": offset, "multiplier": multiplier}
        channels.append(
            f'      <control channel="{k}">\n        <jointName>{thruster.name}_joint</jointName>\n'
            "        <type>COMMAND</type>\n"
            f"        <cmd_topic>/model/{model}/joint/{thruster.name}_joint/cmd_thrust</cmd_topic>\n"
            f"{_tags(tags, 8)}\n      </control>\n"
        )
    return f"""
    <plugin filename="ArduPilotPlugin" name="ArduPilotPlugin">
      <fdm_addr>127.0.0.1</fdm_addr>
      <fdm_port_in>9002</fdm_port_in>
      <connectionTimeoutMaxCount>5</connectionTimeoutMaxCount>
      <lock_step>1</lock_step>
      <modelXYZToAirplaneXForwardZDown degrees="true">0 0 0 180 0 0</modelXYZToAirplaneXForwardZDown>
      <gazeboXYZToNED degrees="true">0 0 0 180 0 90</gazeboXYZToNED>
      <imuName>imu_sensor</imuName>
{"".join(channels)}    </plugin>
"""
