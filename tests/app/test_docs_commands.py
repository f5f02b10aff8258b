"""The commands of the documentation are true: those of a page run in order, in a folder that holds only what they name.

What a page's commands make is used by its later ones; `GIVEN` makes the files that are the reader's own. Commands that
need a vehicle, a network or a person who looks at them are run up to where they would begin: `BEGUN` says why.
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import typer

import towtank as tt
from towtank import campaigns
from towtank.app.cli import app
from towtank.planning import plan as make_plan
from towtank.planning.unsteered import unsteered
from towtank.recording import Recording
from towtank.simulation import Ins, manoeuvre, simulate

from .commands import command
from .conftest import BENCH

sys.path.append(str(Path(__file__).resolve().parents[1] / "readers"))
sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from attack_exchange import UUV
from ros_bags import Said, multi_array, write_bag1

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = [REPOSITORY / "README.md", *sorted(REPOSITORY.glob("docs/**/*.md"))]
REFERENCE = REPOSITORY / "docs" / "command-line.md"
BLOCK = re.compile(r"^```(?:console|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TOML = re.compile(r"^```toml\n(.*?)^```$", re.MULTILINE | re.DOTALL)
IN_A_LINE = re.compile(r"`(towtank [a-z][^`]*)`")
BEGUN = {  # command -> what begins the work in it, and why that is not done here
    "live": ("towtank.app.live.session.run_live", "needs a vehicle, or its sensors, on a link; lasts until Ctrl-C"),
    "demo": (
        "towtank.app.demo.run.run_demo",
        "lasts three minutes, or shows a page until Ctrl-C; its own tests run it",
    ),
}


class Line(NamedTuple):
    """A command as a page has it: where, and its words after `towtank`."""

    place: str
    words: list[str]


def blocks(page: Path) -> list[str]:
    """Return the commands of a page's blocks, long ones in one line, without what they print."""
    text = page.read_text(encoding="utf-8")
    joined = re.sub(r"\n {4,}(?=[\[(-])", " ", "\n".join(found[1] for found in BLOCK.finditer(text)))
    return [line for line in re.findall(r"^(?:\$ )?(towtank [a-z].*)$", joined, re.MULTILINE) if " ± " not in line]


def lines(page: Path) -> list[Line]:
    """Return the commands that a page's blocks hold, the reference's patterns of usage left out."""
    own = [] if page == REFERENCE else blocks(page)
    words = [shlex.split(line, comments=True)[1:] for line in own]
    whole = [each[: each.index("&&")] if "&&" in each else each for each in words]
    return [Line(f"{page.name}: towtank {shlex.join(each)}", each) for each in whole]


SLOW = Ins(imu_rate=20.0, dvl_rate=5.0, depth_rate=5.0, attitude_rate=20.0)


def driven(vehicle: str, seed: int, seconds: float = 6.0) -> Recording:
    """Return a run in which all axes move, 20 samples a second."""
    truth = tt.load_vehicle(vehicle)
    commands = manoeuvre("all-multisine", truth, duration=seconds, dt=0.05, seed=seed).commands
    return simulate(truth, commands=commands, dt=0.05, substeps=5, sensors=SLOW, seed=seed)


def dive(path: Path, seed: int = 1, vehicle: str = "bluerov2_heavy") -> None:
    """Write a run under any name: of a log the content decides what it is."""
    driven(vehicle, seed).write(path.with_suffix(".mcap"))
    path.with_suffix(".mcap").rename(path)


def pool(path: Path, seed: int = 1) -> None:
    """Write the table that the pages show: PWM, gyros, accelerometers, and a heading in degrees."""
    run = driven("bluerov_2016", seed)
    names = {"p": "gyro_x", "q": "gyro_y", "r": "gyro_z", "ax": "acc_x", "ay": "acc_y", "az": "acc_z"}
    thrusters = [thruster.name for thruster in tt.load_vehicle("bluerov_2016").thrusters]
    columns = {"time": run["p"].t}
    columns |= {f"pwm{k}": run[f"cmd_{name}"].values for k, name in enumerate(thrusters, 1)}
    columns |= {column: run[name].values for name, column in names.items()}
    columns["yaw_deg"] = np.degrees(np.interp(run["p"].t, run["psi"].t, run["psi"].values))
    rows = zip(*columns.values(), strict=False)  # of the last instant there is no command
    path.write_text("\n".join([",".join(columns), *(",".join(f"{x:.6g}" for x in row) for row in rows)]) + "\n")


def bag(path: Path) -> None:
    """Write a bag of arrays of numbers, as a small ROV records them."""
    run, said = driven("bluerov_2016", 1), list[Said]()
    commands = np.column_stack([run[name].values for name in run if name.startswith("cmd_")])
    motion = np.column_stack([run[name].values for name in ("p", "q", "r", "ax", "ay", "az")])
    for k, t in enumerate(run["p"].t[: len(commands)]):
        counted = [float(k), *motion[k]]
        said.append(Said("/rovio/imu/data", float(t), "std_msgs/msg/Float64MultiArray", multi_array(counted)))
        said.append(Said("/rovio/thrusters", float(t), "std_msgs/msg/Float64MultiArray", multi_array(commands[k])))
    write_bag1(path, said)


def half_of_a_run(path: Path, *, tracked: bool, seconds: float = 25.0) -> None:
    """Write what the autopilot logged of a run, or what motion capture saw of it on a clock of its own."""
    run = driven("bluerov2_heavy", 3, seconds)
    if tracked:
        t, pose = run["phi"].t - 12.345, [run[name].values for name in ("phi", "theta", "psi")]
        Recording.from_table(t, dict(zip(("phi", "theta", "psi"), pose, strict=True)), source="mocap").write(path)
        return
    Recording({name: run[name] for name in run if name.startswith("cmd_") or name in "pqr"}).write(
        path.with_suffix(".mcap")
    )
    path.with_suffix(".mcap").rename(path)


def text(path: Path, content: str) -> None:
    path.write_text(content)


def vehicle(path: Path, name: str) -> None:
    tt.save_vehicle(tt.load_vehicle(name), path)


def block(path: Path, page: str, word: str) -> None:
    """Write the TOML block of a page that holds a word."""
    [found] = [each[1] for each in TOML.finditer((REPOSITORY / page).read_text()) if word in each[1]]
    path.write_text(found)


def sdf(path: Path) -> None:
    tt.export("lauv", "gz-sim", path.parent / "theirs").files[0].rename(path)


def surge(path: Path, seed: int) -> None:
    truth = tt.load_vehicle("vlbv300")
    commands = manoeuvre("surge-square", truth, duration=5.0, dt=0.05).commands
    simulate(truth, commands=commands, dt=0.05, substeps=5, sensors=SLOW, seed=seed).write(path)


def fleet(path: Path) -> None:
    before = tt.load_vehicle("seamor")
    models = [tt.learn(driven("seamor", seed), before).model for seed in (1, 2)]
    campaigns.pool([campaigns.Run(f"{k}", "seamor", f"{k}", each, before) for k, each in enumerate(models)]).write(path)


def archive(path: Path) -> None:
    """Write the campaign that the page shows, and the logs that it names."""
    block(path, "docs/campaigns.md", "# campaign.toml")
    for k, name in enumerate(("rov7", "rov8"), 1):
        (path.parent / "archive" / name).mkdir(parents=True)
        dive(path.parent / "archive" / name / "dive.BIN", seed=k)


ANGLES = '[columns]\nt = "t"\nphi = "phi"\ntheta = "theta"\npsi = "psi"\n'
Given = dict[str, Callable[[Path], None]]
MINE: Given = {"mine.toml": partial(vehicle, name="bluerov2_heavy")}
GIVEN: dict[str, Given] = {
    "campaigns.md": {"campaign.toml": archive},
    "README.md": {
        "dive.BIN": dive,
        "other-dive.BIN": partial(dive, seed=2),
        "dive.csv": pool,
        "other-dive.csv": partial(pool, seed=2),
        "pool.toml": partial(block, page="README.md", word='t = "time"'),
    },
    "changes.md": {
        "bare.toml": partial(vehicle, name="vlbv300"),
        "learned.toml": partial(vehicle, name="vlbv300"),
        "dive.csv": partial(surge, seed=1),
    },
    **{f"{each}.md": MINE for each in ("c", "casadi", "fmu", "gz-sim", "matlab", "mss", "mujoco", "python")},
    **{f"{each}.md": MINE for each in ("state-space", "urdf-hydrodynamics")},
    "fleets.md": {"first-dive.BIN": partial(dive, seed=3, vehicle="seamor"), "fleet.toml": fleet},
    "importing.md": {"model.sdf": sdf, "rexrov.urdf": partial(text, content=UUV)},
    "index.md": {**MINE, "model.sdf": sdf},
    "learning.md": {"monday.BIN": dive, "friday.BIN": partial(dive, seed=2)},
    "quickstart.md": {},
    "report.md": {"dive.BIN": dive, "other-dive.BIN": partial(dive, seed=2)},
    "validation.md": {
        "learned.toml": partial(vehicle, name="bluerov2_heavy"),
        "mine.toml": partial(vehicle, name="bluerov2_heavy"),
        "yours.toml": partial(vehicle, name="bluerov2_heavy_wu"),
        "another.csv": dive,
        **{f"{name}.csv": partial(surge, seed=k) for k, name in enumerate("ab", 1)},
    },
    "tank-day.md": {
        "bench.csv": partial(text, content=BENCH),
        "tank.mcap": partial(half_of_a_run, tracked=False, seconds=12.0),
        "kept.mcap": partial(half_of_a_run, tracked=False, seconds=12.0),
    },
    "your-log.md": {
        "yaw_1.bag": bag,
        "rovio.toml": partial(block, page="docs/your-log.md", word="/rovio/imu/data"),
        "dive.BIN": partial(half_of_a_run, tracked=False),
        "mocap.csv": partial(half_of_a_run, tracked=True),
        "mocap.toml": partial(text, content=ANGLES),
        "pool-rov.toml": partial(vehicle, name="bluerov_2016"),
        "bench.csv": partial(text, content=BENCH),
        "pool.toml": partial(block, page="docs/your-log.md", word='psi = { from = "yaw_deg"'),
        **{f"pool_{k}.csv": partial(pool, seed=k) for k in (1, 2, 3)},
    },
}


def options(words: list[str]) -> set[str]:
    """Return the options of the command that these words begin with; of a group alone, of all its commands."""
    found: Any = typer.main.get_command(app)
    for word in words:
        if hasattr(found, "commands"):
            found = found.commands[word]
    every = found.commands.values() if hasattr(found, "commands") else [found]
    return {name for each in every for one in each.params for name in (*one.opts, *one.secondary_opts)} | {"--help"}


WITH_COMMANDS = [page for page in PAGES if lines(page)]


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of commands that would have begun their work, a page of the session being there or not."""
    out: list[str] = []
    for name, (begins, _) in BEGUN.items():
        monkeypatch.setattr(begins, lambda *_, name=name, **__: out.append(name) or {})
    monkeypatch.setattr("towtank.dashboard.assets.page_assets", dict)
    return out


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plans are made with the least effort: what they are worth is no matter here."""
    monkeypatch.setitem(make_plan.__kwdefaults__, "tries", 2)
    monkeypatch.setitem(unsteered.__kwdefaults__, "vehicles", 50)


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.name)
def test_the_commands_of_a_page_run_in_order(
    page: Path, begun: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that is given is one that a command needs and none has made."""
    monkeypatch.chdir(tmp_path)
    given = GIVEN.get(page.name, {})
    for name, make in given.items():
        make(tmp_path / name)
    used: set[str] = set()
    for place, words in lines(page):
        ran = command(*words)
        assert ran.code == 0, f"{place}\n{ran}"
        used |= set(words)
    assert begun == [words[0] for _, words in lines(page) if words[0] in BEGUN]
    assert given.keys() <= used
    outputs = [words[k + 1] for _, words in lines(page) for k, word in enumerate(words) if word in ("-o", "--report")]
    if not begun:
        assert [name for name in outputs if not (tmp_path / name).exists() or name in given] == []


def test_every_page_with_commands_is_known_to_this_test() -> None:
    every = [line.words[0] for page in PAGES for line in lines(page)]
    assert BEGUN.keys() <= set(every)
    assert GIVEN.keys() <= {page.name for page in WITH_COMMANDS}
    assert len(every) > 40


@pytest.mark.parametrize(
    "words",
    [["udpin:0.0.0.0:14550"], ["-", "--vehicle", "seamor", "--recrod"], ["-", "--vehicle", "seamor", "--for", 0]],
)
def test_a_command_that_would_begin_can_be_wrong(words: list[object], begun: list[str]) -> None:
    assert command("live", *words).code == 2
    assert begun == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_commands_within_sentences_are_there_with_their_options(page: Path) -> None:
    for found in IN_A_LINE.findall(page.read_text(encoding="utf-8").replace("\n", " ")):
        words = [word for word in found.split()[1:] if re.fullmatch(r"[a-z-]+", word) and not word.startswith("-")]
        named = {word.partition("=")[0] for word in found.split() if word.startswith("--")}
        known = options(words[:2]) if words[0] in ("vehicle", "campaign", "config", "manoeuvre") else options(words[:1])
        assert named <= known | {"--install-completion", "--show-completion"}, found


def test_the_reference_names_every_option_of_every_command() -> None:
    """Patterns of usage in the reference: all options but --help and --json, which all commands have."""
    text, told = REFERENCE.read_text(encoding="utf-8"), dict[str, set[str]]()
    for usage in blocks(REFERENCE):
        words = usage.split()[1:]
        name = " ".join(words[: 2 if words[0] in ("vehicle", "campaign", "config", "manoeuvre") else 1])
        told.setdefault(name, set()).update(re.findall(r"(?<![\w-])(--?[a-z][a-z-]*)", usage))
    for name, named in told.items():
        known = options(name.split())
        assert named <= known, f"{name}: there is no {', '.join(named - known)}"
        section = text.split(f"\n## {name.split()[0]}\n")[1].split("\n## ")[0]
        implied = {"--help", "--json", "-h", "-o"} | ({"--output"} if "-o" in named or "`-o`" in section else set())
        implied |= {option for option in known if option.replace("--", "--no-", 1) in named}
        untold = [each for each in known - named - implied if each.startswith("-") and each not in section]
        assert untold == [], name
