"""`towtank live` with real peers on this machine: what it learns of surge and yaw against the truth.

    make peers            (or: python benchmarks/peers/run_peers.py [mavsdk|ros2|dds|json|dask|s3 ...])

The same simulated BlueROV2 Heavy is played in real time by three peers, each in a process of its own, over loopback:

    mavsdk   MAVSDK as autopilot over UDP: HEARTBEAT, ATTITUDE, LOCAL_POSITION_NED, SERVO_OUTPUT_RAW, EKF_STATUS_REPORT,
             parameters; ArduSub's slow rates until they are asked for faster
    ros2     rclpy over Fast DDS: nav_msgs/Odometry and geometry_msgs/WrenchStamped
    dds      the same ROS 2, heard by Cyclone DDS without anything of ROS
    json     JSON lines over UDP

`towtank live` begins with coefficients that are 0.6 times the true ones. X_udot, X_u, X_uu, N_rdot and N_rr must come
out within 5 % of the truth. All of these peers but the last have environments of their own, in .peers.

`dask` and `s3` are peers of `towtank campaign`, in `fleet`: a scheduler and its workers while they are killed, and an
object store behind a proxy that fails.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import tomlkit
from played import FREE, LEAD, SECONDS, VEHICLE, free_port, write_trajectory

from towtank import load_vehicle
from towtank.vehicle import Vehicle

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
TOLERANCE = 5.0  # %
START = 0.6  # of the true coefficients
PYTHON = {name: ROOT / ".peers" / name / "bin" / "python" for name in ("mavsdk", "ros2")} | {
    "dds": ROOT / ".peers" / "ros2" / "bin" / "python",
    "json": Path(sys.executable),
}
FLEET = {
    "dask": (ROOT / ".peers" / "dask" / "bin" / "python", HERE / "fleet" / "dask_peer.py"),
    "s3": (Path(sys.executable), HERE / "fleet" / "s3_peer.py"),
}
CYCLONE = """<CycloneDDS><Domain Id="any"><General><AllowMulticast>false</AllowMulticast>
<Interfaces><NetworkInterface name="lo"/></Interfaces></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""
LOOPBACK = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": "77", "CYCLONEDDS_URI": CYCLONE}


def wrong_start(folder: Path) -> Path:
    """Write the vehicle with coefficients that are wrong."""
    from importlib.resources import files

    text = files("towtank.vehicle").joinpath(f"catalog/{VEHICLE}.toml").read_text(encoding="utf-8")
    data = tomlkit.parse(text)
    for coefficient in data["hydrodynamics"].values():  # type: ignore[union-attr]
        coefficient["value"] *= START
    path = folder / "start.toml"
    path.write_text(tomlkit.dumps(data), encoding="utf-8")
    return path


def session(name: str, folder: Path, start: Path) -> dict[str, object]:
    """Let a peer play the vehicle to `towtank live`; return its document."""
    port = free_port()
    source = {
        "mavsdk": f"udpin:127.0.0.1:{port}",
        "ros2": "ros2:77",
        "dds": "dds:77",
        "json": f"json:127.0.0.1:{port}",
    }[name]
    trajectory = folder / f"{name}.jsonl"
    write_trajectory(trajectory, by_wrench=name in ("ros2", "dds"))
    python = PYTHON["ros2"] if name == "ros2" else Path(sys.executable)  # rclpy is in the peer's environment
    command = [str(python), "-m", "towtank", "live", source, "--vehicle", str(start), "--json", "--free", FREE]
    recording = folder / f"{name}.mcap"
    environment = os.environ | LOOPBACK
    with subprocess.Popen(
        [*command, "--record", str(recording), "--for", str(SECONDS + LEAD + 5.0)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as live:
        assert live.stderr is not None
        told = []
        for line in live.stderr:
            told.append(line)
            if line.startswith("listening"):
                break
        else:
            raise SystemExit(f"{name}: towtank live does not start:\n{''.join(told)}")
        peer = subprocess.run(
            [str(PYTHON[name]), str(HERE / f"{'ros2' if name == 'dds' else name}_peer.py"), str(trajectory), str(port)],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        out, err = live.communicate()
        if peer.returncode != 0:
            raise SystemExit(f"{name}: the peer failed with {peer.returncode}:\n{peer.stderr[-2000:]}")
    if live.returncode != 0:
        raise SystemExit(f"{name}: towtank live ended with {live.returncode}:\n{err}")
    document: dict[str, object] = json.loads(out)
    return document


def judged(name: str, document: dict[str, object], truth: Vehicle) -> bool:
    """Print what was learned against the truth; return whether all of it is within the tolerance."""
    learned: dict[str, dict[str, object]] = document["coefficients"]  # type: ignore[assignment]
    live: dict[str, object] = document["live"]  # type: ignore[assignment]
    good = True
    print(f"\n{name}: {document['samples']} samples, delay {1e3 * float(document['delay_s'] or 0):.0f} ms")  # type: ignore[arg-type]
    for coefficient in ("X_udot", "X_u", "X_uu", "N_rdot", "N_rr"):
        true = truth.hydrodynamics[coefficient].value
        found = learned.get(coefficient, {})
        value = found.get("value")
        if value is None or not found.get("identified"):
            print(f"  {coefficient:8} not identified: {found.get('reason')}")
            good = False
            continue
        off = 100.0 * (float(value) / true - 1.0)  # type: ignore[arg-type]
        fits = abs(off) <= TOLERANCE
        good &= fits
        mark = "" if fits else "  <-- off"
        print(f"  {coefficient:8} {value:10.4g} ± {found['std']:.2g}, true {true:.4g}: {off:+.1f} %{mark}")
    print(f"  dropped {live['dropped']}, late {live['late']}, bad {live['bad']}, latency {live['latency_ms']}")
    for source in live["sources"].values():  # type: ignore[attr-defined]
        strange = source["strange_stamps"]
        print(f"  {source['samples']} samples, {strange} stamps not believed, rates {source['rates_hz']}")
        for line in source["said"]:
            print(f"  {line}")
    for warning in document["warnings"]:  # type: ignore[attr-defined]
        print(f"  warning: {warning}")
    return good


def main(names: Sequence[str]) -> int:
    """Run the peers named, all by default."""
    truth = load_vehicle(VEHICLE)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        start = wrong_start(folder)
        live = [name for name in names or PYTHON if name not in FLEET]
        results = {name: judged(name, session(name, folder, start), truth) for name in live}
    fleet = {}
    for name in [name for name in names or FLEET if name in FLEET]:
        print(f"\n{name}", flush=True)
        fleet[name] = subprocess.run([str(each) for each in FLEET[name]], check=False).returncode == 0
    print()
    for name, good in results.items():
        print(f"{name:8} {'ok: within' if good else 'FAILED: not within'} {TOLERANCE:g} % of the truth")
    for name, good in fleet.items():
        print(f"{name:8} {'ok' if good else 'FAILED'}")
    return 0 if all([*results.values(), *fleet.values()]) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
