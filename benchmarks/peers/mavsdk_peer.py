"""MAVSDK as the autopilot of the vehicle: streams it over UDP, at the rates that it is asked for."""

from __future__ import annotations

import json
import math
import os
import sys
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer, MavlinkMessage
from mavsdk.plugins.param_server import ParamServer
from played import STEP, paced

SET_INTERVAL = 511
RATES = {  # Hz until others are asked for, as ArduSub's; with the numbers of the messages
    30: ("ATTITUDE", 10.0),
    32: ("LOCAL_POSITION_NED", 3.0),
    36: ("SERVO_OUTPUT_RAW", 2.0),
    193: ("EKF_STATUS_REPORT", 2.0),
}
AIDED = 1 | 2 | 4 | 8 | 16 | 32
BOOT = 300.0  # s that it has been running
STATUS = """<mavlink><messages><message id="193" name="EKF_STATUS_REPORT"><field type="uint16_t" name="flags"/>
<field type="float" name="velocity_variance"/><field type="float" name="pos_horiz_variance"/>
<field type="float" name="pos_vert_variance"/><field type="float" name="compass_variance"/>
<field type="float" name="terrain_alt_variance"/><extensions/><field type="float" name="airspeed_variance"/>
</message></messages></mavlink>"""

mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.AUTOPILOT))
if mavsdk.add_any_connection(f"udpout://127.0.0.1:{sys.argv[2]}").value != 0:
    sys.exit("no connection")
component = mavsdk.server_component()
parameters = ParamServer(component)
for n in range(1, 9):
    parameters.provide_param_int(f"SERVO{n}_FUNCTION", 32 + n)
    parameters.provide_param_float(f"MOT_{n}_DIRECTION", 1.0)
server = MavlinkDirectServer(component)
intervals = {number: 1.0 / rate for number, (_, rate) in RATES.items()}


def send(name: str, **fields: Any) -> None:
    server.send_message(MavlinkMessage(name, fields_json=json.dumps(fields)))


def requested(message: Any, _: Any) -> None:
    fields = json.loads(message.fields_json)
    number, interval = int(fields["param1"]), float(fields["param2"])
    known = number in intervals
    if known:
        intervals[number] = max(1e-6 * interval, STEP)
    to = {"target_system": message.system_id, "target_component": message.component_id}
    send("COMMAND_ACK", command=SET_INTERVAL, result=0 if known else 2, **to)


server.subscribe_command(SET_INTERVAL, requested)
try:
    server.load_custom_xml(STATUS)
except Exception as error:
    print(f"EKF_STATUS_REPORT: {error}", file=sys.stderr)
due = dict.fromkeys(intervals, 0.0)
for at, frame in paced(sys.argv[1]):
    milliseconds = round(1e3 * (BOOT + at))
    (x, y, z, phi, theta, psi), (u, v, w, p, q, r) = frame["eta"], frame["nu"]
    c1, s1, c2, s2, c3, s3 = (f(a) for a in (phi, theta, psi) for f in (math.cos, math.sin))
    north = u * c3 * c2 + v * (c3 * s2 * s1 - s3 * c1) + w * (s3 * s1 + c3 * c1 * s2)
    east = u * s3 * c2 + v * (c3 * c1 + s1 * s2 * s3) + w * (s2 * s3 * c1 - c3 * s1)
    down = -u * s2 + v * c2 * s1 + w * c2 * c1
    now = {
        30: {"roll": phi, "pitch": theta, "yaw": math.remainder(psi, math.tau), "rollspeed": p, "pitchspeed": q}
        | {"yawspeed": r, "time_boot_ms": milliseconds},
        32: {"x": x, "y": y, "z": z, "vx": north, "vy": east, "vz": down, "time_boot_ms": milliseconds},
        36: {f"servo{n}_raw": round(pulse) for n, pulse in enumerate(frame["cmd"], 1)}
        | {"time_usec": 1000 * milliseconds, "port": 0},
        193: {"flags": AIDED, "velocity_variance": 0.1, "pos_horiz_variance": 0.1, "pos_vert_variance": 0.1}
        | {"compass_variance": 0.1, "terrain_alt_variance": 0.0},
    }
    for number, fields in now.items():
        if at >= due[number] - 0.5 * STEP:
            due[number] = max(due[number] + intervals[number], at)
            send(RATES[number][0], **fields)
os._exit(0)  # its threads are not waited for
