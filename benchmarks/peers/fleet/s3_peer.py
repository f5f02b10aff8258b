"""A campaign whose logs and store are in S3, through a proxy that fails.

    make peers PEERS=s3        (or: python benchmarks/peers/fleet/s3_peer.py [--share 0.05] [--tasks 200])

The object store is moto's server, in an environment of its own, on loopback. Of all requests 5 % end in an answer of
503, a reset connection, a stall, or a body that is cut in half, of the request or of the answer.

    logs      learned from logs in a bucket into a store in a bucket: the table of the same logs on this disk
    tasks     many small tasks: every one done, none failed
    whole     looked at without the proxy, every object is whole

MinIO, Amazon's and Google's own stores were not tried.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import pieces
import pyarrow.parquet as pq
from pyarrow import fs
from s3_proxy import FailingProxy

from towtank import load_vehicle, simulate
from towtank.campaigns import Store, read_campaign, run_campaign, tasks_of
from towtank.campaigns.engines.local import Local
from towtank.simulation import manoeuvre
from towtank.vehicle.files import parse_vehicle

ROOT = Path(__file__).parents[3]
SERVER = ROOT / ".peers" / "s3" / "bin" / "moto_server"
LOGS = 6
LEARN = """kind = "learn"
logs = ["{logs}"]
vehicle = "vlbv300"
method = "paper"
free = ["X_udot", "X_uu"]
delay = 0.0
"""


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def direct(port: int) -> fs.S3FileSystem:
    """Return the store itself, not through the proxy."""
    return fs.S3FileSystem(
        endpoint_override=f"127.0.0.1:{port}", scheme="http", region="us-east-1", allow_bucket_creation=True
    )


def record(folder: Path) -> None:
    """Write short simulated logs of two vehicles."""
    truth = load_vehicle("vlbv300")
    driven = manoeuvre("surge-square", truth, duration=6.0, dt=0.05)
    for k in range(LOGS):
        path = folder / "archive" / f"rov{k % 2}" / f"dive-{k}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        simulate(truth, **driven.inputs, sensors="ins", seed=k, substeps=5).write(path)


def campaign(folder: Path, name: str, logs: str, store: str) -> tuple[Store, int]:
    """Learn from logs; return the store and how many tasks failed."""
    from towtank.app.campaign.work import perform

    path = folder / f"{name}.toml"
    path.write_text(LEARN.format(logs=logs))
    asked = read_campaign(path)
    tasks, kept = tasks_of(asked), Store.at(store)
    kept.begin(asked, tasks)
    done = run_campaign(tasks, kept, Local(2), perform)
    for each in done.failures:
        print(f"  {each.line}")
    return kept, len(done.failures)


def learned(folder: Path, there: fs.S3FileSystem) -> bool:
    record(folder)
    for path in (folder / "archive").rglob("*.csv"):
        with there.open_output_stream(f"archive/{path.relative_to(folder / 'archive')}") as stream:
            stream.write(path.read_bytes())
    here, failed_here = campaign(folder, "here", "archive/*/*.csv", str(folder / "here"))
    away, failed = campaign(folder, "away", "s3://archive/*/*.csv", "s3://results/learned")
    columns = ["seconds", "run"]
    same = away.table().drop(columns).equals(here.table().drop(columns))
    print(
        f"  {away.table().num_rows} rows of {LOGS} logs, {failed} failed, {'the same' if same else 'not those'} as here"
    )
    return same and not failed and not failed_here and away.table().num_rows > 0


def many(folder: Path, count: int) -> bool:
    path = folder / "nothing.toml"
    path.write_text(LEARN.format(logs="archive/*/*.csv"))
    store, tasks = Store.at("s3://results/many"), pieces.tasks(count, "aaaa")
    store.begin(read_campaign(path), tasks)
    done = run_campaign(tasks, store, Local(2), pieces.quick)
    before = store.table()
    store.compact()
    same = store.table().equals(before)
    print(
        f"  {done.performed} of {count} tasks in {done.seconds:.0f} s, {len(done.failures)} failed; compacted: {same}"
    )
    return same and not done.failures and before.num_rows == count


def whole(there: fs.S3FileSystem) -> bool:
    """Whether every object is one that can be read to its end."""
    count, half = 0, []
    for entry in there.get_file_info(fs.FileSelector("results", recursive=True)):
        if not entry.is_file:
            continue
        count += 1
        data = there.open_input_stream(entry.path).read()
        try:
            if entry.path.endswith(".parquet"):
                pq.read_table(io.BytesIO(data))
            elif entry.path.endswith(".toml"):
                parse_vehicle(data.decode(), entry.path)
        except Exception:
            half.append(entry.path)
    print(f"  {count} objects, {len(half)} of them not whole")
    return not half and count > 0


def main(argv: Sequence[str] | None = None) -> int:
    """0 where all of it holds."""
    parser = argparse.ArgumentParser(description="A campaign in S3, through a proxy that fails.")
    parser.add_argument("--share", type=float, default=0.05, help="of requests that fail (default 0.05)")
    parser.add_argument("--tasks", type=int, default=200, help="small ones (default 200)")
    parser.add_argument("--seed", type=int, default=1, help="of what fails")
    options = parser.parse_args(argv)
    port = free_port()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        known = {"AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing", "AWS_REGION": "us-east-1"}
        os.environ.update(known | {"AWS_EC2_METADATA_DISABLED": "true", "TOWTANK_CACHE": str(folder / "cache")})
        log = (folder / "moto.log").open("wb")
        server = subprocess.Popen([str(SERVER), "-H", "127.0.0.1", "-p", str(port)], stdout=log, stderr=log)
        proxy = FailingProxy(port, options.share, options.seed)
        os.environ["AWS_ENDPOINT_URL"] = f"http://127.0.0.1:{proxy.port}"
        os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT / "src"), str(Path(__file__).parent)])
        try:
            there = direct(port)
            began = time.monotonic()
            for bucket in ("archive", "results"):
                while True:
                    try:
                        there.create_dir(bucket)
                        break
                    except OSError:
                        if time.monotonic() - began > 60.0:
                            raise
                        time.sleep(0.5)
            results = {"logs": learned(folder, there), "tasks": many(folder, options.tasks), "whole": whole(there)}
            print(f"  requests: {', '.join(f'{count} {what}' for what, count in sorted(proxy.counts.items()))}")
        finally:
            proxy.close()
            server.terminate()
            server.wait()
            shutil.rmtree(folder / "cache", ignore_errors=True)
    print()
    for name, good in results.items():
        print(f"{name:10} {'ok' if good else 'FAILED'}")
    return 0 if all(results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
