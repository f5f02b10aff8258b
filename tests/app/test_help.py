"""Help is quick, complete, and its examples run."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from towtank import export
from towtank.campaigns import Store, read_campaign, tasks_of
from towtank.readers import read
from towtank.recording import Channel, Recording

from .commands import command

COMMANDS = [
    ["demo"],
    ["vehicle", "list"],
    ["vehicle", "show"],
    ["vehicle", "copy"],
    ["vehicle", "prior"],
    ["vehicle", "check"],
    ["vehicle", "fit-thruster"],
    ["manoeuvre", "list"],
    ["plan"],
    ["simulate"],
    ["inspect"],
    ["learn"],
    ["live"],
    ["validate"],
    ["campaign", "run"],
    ["campaign", "status"],
    ["campaign", "table"],
    ["campaign", "compact"],
    ["config", "list"],
    ["config", "save"],
    ["config", "show"],
    ["config", "compare"],
    ["convert"],
    ["export"],
    ["import"],
]
STUDY = """kind = "simulate-learn"
vehicle = "vlbv300"
method = "paper"
free = ["X_udot", "X_uu"]
delay = 0.0
[study]
manoeuvre = "surge-square"
duration = 6.0
rate = 20.0
sensors = "ins"
"""
HEAVY = {
    "matplotlib",
    "mcap",
    "numba",
    "numpy",
    "pyarrow",
    "pydantic",
    "pymavlink",
    "rich",
    "rosbags",
    "scipy",
    "tomlkit",
}


def examples(words: list[str]) -> list[str]:
    """Return the example lines of a command's help."""
    return re.findall(r"^ +(towtank .+)$", command(*words, "--help").out.split("Options:")[0], re.MULTILINE)


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_has_help_with_an_example_and_json(words: list[str]) -> None:
    ran = command(*words, "--help")
    assert ran.code == 0
    assert examples(words)
    assert all(example.startswith(f"towtank {' '.join(words)}") for example in examples(words))
    assert "--json" in ran.out
    assert "{" not in ran.out


def test_the_list_of_commands_is_whole() -> None:
    listed = re.findall(r"^  ([a-z]+)  ", command("--help").out, re.MULTILINE)
    first = ["demo", "vehicle", "manoeuvre", "plan", "simulate", "inspect", "learn", "live", "validate"]
    assert listed == [*first, "campaign", "config", "convert", "export", "import"]


def thinned(run: Recording) -> Recording:
    """Return every fourth sample, so that examples learn from a dozen a second."""
    return run.replace(
        [Channel(name, each.t[::4], each.values[::4], each.unit, each.frame) for name, each in run.channels.items()]
    )


@pytest.mark.parametrize("words", [words for words in COMMANDS if words not in (["demo"], ["live"])], ids=" ".join)
@pytest.mark.usefixtures("hurried")
def test_examples_run(words: list[str], workshop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("learned.toml", "bench.csv"):
        shutil.copy(workshop / name, tmp_path / name)
    named = 20.0 if words == ["learn"] else 8.0  # the examples of learn name windows
    thinned(read(workshop / "surge.csv").window(0.0, named)).write(tmp_path / "surge.csv")
    if words == ["import"]:
        export("lauv", "gz-sim", tmp_path)
    shutil.copy(workshop / "learned.toml", tmp_path / "mine.toml")
    monkeypatch.chdir(tmp_path)
    if words in (["config", "show"], ["config", "compare"]):
        for name in ("bare", "with gripper"):
            assert command("config", "save", "learned.toml", "--name", name).code == 0
    if words[0] == "campaign":
        (tmp_path / "campaign.toml").write_text(STUDY)
        asked = read_campaign("campaign.toml")
        Store.at("results").begin(asked, tasks_of(asked))
    for example in examples(words):
        ran = command(*shlex.split(example)[1:])
        assert ran.code == 0, ran


def test_the_first_example_is_a_whole_story(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("simulate", "vlbv300", "all-multisine", "-o", "another.csv")
    assert command(*words, "--duration", 12, "--rate", 25).code == 0
    story = re.findall(r"^ +(towtank .+)$", command("--help").out, re.MULTILINE)
    assert len(story) == 3
    for line in story:
        ran = command(*shlex.split(line)[1:])
        assert ran.code == 0, ran


@pytest.mark.parametrize("words", [["--help"], ["learn", "--help"], ["--version"], ["vehicle", "--help"]], ids=" ".join)
def test_help_loads_nothing_heavy(words: list[str]) -> None:
    code = (
        "import sys\nfrom towtank.app.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True, timeout=60)
    typers_own = {"pydantic"} if len(words) == 2 else set()
    assert (HEAVY - typers_own).isdisjoint(run.stderr.split())
