"""An attack on what imports vehicles: whatever an XML file holds, it is a vehicle or refused in one line.

    python benchmarks/studies/attack_exchange.py [--runs 10000] [--seed 1] [--workers 2]

Models of every kind are broken: bytes flipped, cut and spliced (`mutations`); numbers, names and references that no
simulator writes; elements repeated, moved, nested; entities, bombs, other encodings. Of what is read, the vehicle
must be one that can be written, read again, and exported or refused. Counted are tracebacks, warnings of libraries,
more than 10 s, and refusals that are no line that names the file. None is allowed: the exit code is 1 where there is
one.
"""

from __future__ import annotations

import random
import re
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from functools import cache
from pathlib import Path
from typing import NamedTuple

from mutations import mutated
from report import show
from rich.table import Table
from rich.text import Text
from runner import arguments, over

from towtank import InputError, export, import_vehicle, load_vehicle
from towtank.vehicle import VehicleWarning, parse_vehicle, vehicle_text

LONGEST = 10.0  # s
_BLOCK = 50  # files of one task
_NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")
_ELEMENT = re.compile(r"<(\w+)[^<>]*/>|<(\w+)[^<>]*>[^<>]*</\2>")
_WORDS = (
    *("nan", "inf", "-1e308", "1e999", "0", "-0.0", "", "1,5", "0x10", "1_0", "${m}", "1 2", "9" * 5000, "\u0663"),
    *("true", "1e-320", "-1", "1e9", "  7  ", "None"),
)
_BOMB = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10 if k else "ha" * 10}">' for k in range(9))
UUV = """<?xml version="1.0"?>
<robot name="r"><link name="b"><inertial><mass value="18"/><origin xyz="0 0 0.01" rpy="0 0 0.1"/>
<inertia ixx="0.5" ixy="0" ixz="0" iyy="0.8" iyz="0" izz="0.9"/></inertial></link>
<link name="t"/><joint name="j" type="continuous"><parent link="b"/><child link="t"/>
<origin xyz="-0.4 0.1 0" rpy="0 0 1.5"/><axis xyz="1 0 0"/></joint>
<gazebo><plugin filename="libuuv_underwater_object_ros_plugin.so"><fluid_density>1028</fluid_density>
<link name="b"><volume>0.018</volume><center_of_buoyancy>0 0 0.06</center_of_buoyancy><hydrodynamic_model>
<type>fossen</type><added_mass>4 0 0 0 0 0 0 16 0 0 0 0 0 0 16 0 0 0 0 0 0 0.1 0 0 0 0 0 0 1.3 0 0 0 0 0 0 1.3
</added_mass><linear_damping>-2 -23 -23 -0.3 -9 -9</linear_damping>
<linear_damping_forward_speed>0 -8 0 0 0 -3</linear_damping_forward_speed>
<quadratic_damping>-3 -80 -80 -0.1 -9 -9</quadratic_damping></hydrodynamic_model></link></plugin></gazebo>
<gazebo><plugin filename="libuuv_thruster_ros_plugin.so"><linkName>t</linkName><jointName>j</jointName><gain>2</gain>
<dynamics><type>FirstOrder</type><timeConstant>0.05</timeConstant></dynamics><conversion><type>LinearInterp</type>
<inputValues>-10 0 10</inputValues><outputValues>-5 0 6</outputValues></conversion></plugin></gazebo></robot>
"""


CLASSIC = UUV[: UUV.index("<robot")] + (
    """<sdf version="1.6"><model name="r"><link name="b"><inertial><mass>18</mass><pose>0 0 0.01 0 0 0.1</pose>
<inertia><ixx>0.5</ixx><iyy>0.8</iyy><izz>0.9</izz></inertia></inertial></link>
<link name="t"><pose>-0.4 0.1 0 0 0 1.5</pose></link><joint name="j" type="revolute"><parent>b</parent><child>t</child>
<axis><xyz>1 0 0</xyz></axis></joint>"""
    + UUV[UUV.index("<gazebo>") : UUV.rindex("</robot>")].replace("<gazebo>", "").replace("</gazebo>", "")
    + "</model></sdf>"
)
XACRO = UUV.replace(
    '<robot name="r">',
    """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="m" value="${9 * 2}"/>
<xacro:macro name="empty" params="n:=1 *block"><link name="l${n}"/><xacro:insert_block name="block"/></xacro:macro>
<xacro:empty n="2"><link name="k"/></xacro:empty><xacro:if value="${m > 10}"><link name="h"/></xacro:if>""",
).replace('<mass value="18"/>', '<mass value="${m}"/>')


class Result(NamedTuple):
    """What came of files: how many were read or refused, and what was wrong, with the file's number."""

    read: int
    refused: int
    wrong: tuple[str, ...]
    slowest: float


@cache
def sound() -> tuple[tuple[bytes, ...], bytes]:
    """Return sound files of every kind that can be imported, and the YAML that stands beside some."""
    out = [UUV.encode()]
    with tempfile.TemporaryDirectory() as name:
        for vehicle in ("lauv", "bluerov2_heavy"):
            for target in ("gz-sim", "urdf-hydrodynamics"):
                out.append(export(vehicle, target, Path(name) / f"{vehicle}{target}").files[0].read_bytes())
        out.append((Path(name) / "lauvgz-sim" / "world.sdf").read_bytes())
        yaml = (Path(name) / "lauvurdf-hydrodynamics" / "thrusters.yaml").read_bytes()
    out += [CLASSIC.encode(), XACRO.encode()]
    return tuple(out), yaml


def hostile(text: str, rng: random.Random) -> bytes:
    """Return a model with something in it that no simulator writes."""
    head, _, rest = text.partition("?>")
    kind = rng.randrange(9)
    if kind == 0:  # numbers
        places = list(_NUMBER.finditer(text))
        for match in sorted(rng.sample(places, min(len(places), rng.choice((1, 1, 3, 20)))), key=lambda m: -m.start()):
            text = text[: match.start()] + rng.choice(_WORDS) + text[match.end() :]
    elif kind == 1:  # names and references
        names = re.findall(r'name="([^"]+)"', text)
        text = text.replace(rng.choice(names), rng.choice(["", "a" * 3000, "::", "../../x", "\u202e", *names]))
    elif kind == 2:  # an element again, elsewhere
        spans = list(_ELEMENT.finditer(text))
        taken, where = rng.choice(spans), rng.choice(spans)
        text = text[: where.start()] + taken[0] * rng.choice((1, 2, 50)) + text[where.start() :]
    elif kind == 3:  # an element gone
        taken = rng.choice(list(_ELEMENT.finditer(text)))
        text = text[: taken.start()] + text[taken.end() :]
    elif kind == 4:
        text = f"{head}?><!DOCTYPE z [{_BOMB}]>{rest}".replace(">0", ">&a8;", 1)
    elif kind == 5:
        file = rng.choice(("file:///etc/passwd", "http://localhost/x", "php://filter"))
        text = f'{head}?><!DOCTYPE z [<!ENTITY x SYSTEM "{file}">]>{rest}'.replace(">0", ">&x;", 1)
    elif kind == 6:
        depth = rng.choice((30, 100, 5000))
        text = text.replace("</plugin>", "<a>" * depth + "</a>" * depth + "</plugin>", 1)
    elif kind == 7:
        tag = rng.choice(re.findall(r"<(\w+)>", text) or ["mass"])
        text = text.replace(f"<{tag}>", f"<{rng.choice(('a', 'link', 'model', tag.upper()))}>").replace(
            f"</{tag}>", f"</{rng.choice(('a', 'link', 'model', tag.upper()))}>"
        )
    else:
        return text.encode(rng.choice(("utf-16", "utf-32", "cp037", "utf-7")), "replace")
    return text.encode("utf-8", "surrogatepass")


def attack(seeds: range) -> Result:
    """Import a file for every seed."""
    read = refused = 0
    wrong, slowest = list[str](), 0.0
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "model.xml"
        for seed in seeds:
            rng = random.Random(seed)
            files, yaml = sound()
            data = rng.choice(files)
            broken = hostile(data.decode(), rng) if rng.random() < 0.5 else mutated(data, files, rng)[1]
            path.write_bytes(broken)
            if b"<hydrodynamics>" in data:  # its thrusters stand beside it
                beside = path.with_name("thrusters.yaml")
                beside.write_bytes(mutated(yaml, (yaml,), rng)[1] if rng.random() < 0.5 else yaml)
                path.write_bytes(data if rng.random() < 0.5 else broken)
            began = time.perf_counter()
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", VehicleWarning)
                try:
                    vehicle = import_vehicle(path).vehicle
                    parse_vehicle(vehicle_text(vehicle), str(path))
                    read += 1
                    try:
                        export(vehicle, "gz-sim", Path(name) / "out")
                    except InputError as error:
                        if "\n" in str(error):
                            wrong.append(f"{seed}: export: {error}")
                except InputError as error:
                    refused += 1
                    if "\n" in str(error) or not str(error).startswith(name) or len(str(error)) > 600:
                        wrong.append(f"{seed}: refusal: {str(error)[:300]!r}")
                except Exception:
                    wrong.append(f"{seed}: {traceback.format_exc(limit=-2)}")
            took = time.perf_counter() - began
            slowest = max(slowest, took)
            if took > LONGEST:
                wrong.append(f"{seed}: {took:.0f} s")
    return Result(read, refused, tuple(wrong), slowest)


def main() -> int:
    """Attack; return 1 where anything was wrong."""
    options = arguments(__doc__ or "", runs=10_000)
    load_vehicle("lauv")
    seeds = [
        range(start, min(start + _BLOCK, options.seed + options.runs))
        for start in range(options.seed, options.seed + options.runs, _BLOCK)
    ]
    results = over("models", attack, [(each,) for each in seeds], options.workers)
    table = Table("Files", "Read", "Refused", "Wrong", "Slowest, s")
    wrong = [line for each in results for line in each.wrong]
    read, refused = sum(each.read for each in results), sum(each.refused for each in results)
    slowest = max(each.slowest for each in results)
    table.add_row(str(options.runs), str(read), str(refused), str(len(wrong)), f"{slowest:.2f}")
    for line in wrong[:12]:
        show(Text(line))
    for words, count in Counter(line.strip().splitlines()[-1][:100] for line in wrong).most_common(12):
        show(Text(f"{count} x {words}"))
    show(table)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
