"""The file of a campaign: what it may say, what each mistake is told, and what its tasks are called."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from towtank.campaigns import Campaign, Task, read_campaign, tasks_of
from towtank.errors import InputError
from towtank.vehicle.files import catalog_text

sys.path.append(str(Path(__file__).parent))  # processes that are started import it too

from campaign_pieces import LEARN, STUDY, campaign, log

LOGS = LEARN.format(method="joint")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOWTANK_CACHE", str(tmp_path / "cache"))


def read(folder: Path, text: str) -> Campaign:
    return read_campaign(campaign(folder, text))


@pytest.mark.parametrize(
    "text, said",
    [
        (
            'kind = "lern"\nvehicle = "vlbv300"',
            'kind: found the text "lern", expected one of learn, validate',
        ),
        ('kind = "learn"\nlogs = ["*"]', "vehicle: missing"),
        ('kind = "learn"\nvehicle = "vlbv300"', "logs: missing; expected patterns of logs"),
        ('kind = "learn"\nlog = ["*"]\nvehicle = "vlbv300"', 'log: unknown key; did you mean "logs"?'),
        (LOGS.replace("joint", "jont"), 'method: found the text "jont", expected one of joint, output-error, paper'),
        (
            LOGS.replace("vlbv300", "vlbv30"),
            'vehicle: "vlbv30" is neither a vehicle of the catalog; did you mean',
        ),
        (LOGS + "delay = -1.0", "delay: found -1, expected 0 or more"),
        (LOGS + "horizon = 3.0", "horizon: has no meaning for kind learn"),
        (LOGS + 'map = "pool.toml"', "map: "),
        (LEARN.format(method="paper") + 'prior = "vlbv300"', "prior: the method paper takes none"),
        (LOGS + '[study]\nmanoeuvre = "surge-sine"', "study: found beside kind learn"),
        ('kind = "simulate-learn"\nvehicle = "vlbv300"', "study: missing; simulate-learn needs [study]"),
        (STUDY.format(runs=0, seed=1), "study.runs: found 0, expected a whole number of 1 or more"),
        (STUDY.format(runs=1, seed=1).replace("surge-square", "surge-sqare"), "study.manoeuvre: found the text"),
        (STUDY.format(runs=1, seed=1) + '"Q_uu" = 0.1', "study.within.Q_uu: there is no such coefficient"),
        (STUDY.format(runs=1, seed=1) + '"X_uu" = 10.0', "study.within.X_uu: found 10, expected a share of 1 or less"),
        (
            STUDY.format(runs=1, seed=1) + '"N_uv" = 0.1',
            "study.within.N_uv: vlbv300 has no such coefficient",
        ),
        ("kind = learn", "campaign.toml:1:8: not valid TOML"),
        (LOGS.replace('"vlbv300"', "3"), "vehicle: found 3, expected a text, or a table of folders"),
    ],
)
def test_a_mistake_in_the_file_is_one_line_that_names_its_place(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert "campaign.toml" in str(caught.value)
    assert said in str(caught.value)


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: no such file; expected the file of a campaign"):
        read_campaign(tmp_path / "none.toml")


def test_a_pattern_that_matches_nothing_is_named_with_where_it_begins(tmp_path: Path) -> None:
    log(tmp_path, "archive/rov7/a.tsv")
    with pytest.raises(InputError, match=r'logs: no log matches "archive/\*/\*\.csv"; paths begin in '):
        tasks_of(read(tmp_path, LOGS))


def test_a_log_is_of_the_vehicle_whose_folder_it_lies_in(tmp_path: Path) -> None:
    for name in ("rov7/a.csv", "rov8/deep/b.csv", "boat/c.csv"):
        log(tmp_path, f"archive/{name}", f"t,u\n0,{len(name)}\n")
    text = LOGS.replace("*/*.csv", "**/*.csv").replace('vehicle = "vlbv300"\n', "")
    found = tasks_of(read(tmp_path, text + '[vehicle]\n"rov*" = "bluerov2_heavy"\nboat = "vlbv300"\n'))
    assert {(each.label, each.vehicle, each.klass) for each in found} == {
        ("archive/boat/c.csv", "boat", "vlbv300"),
        ("archive/rov7/a.csv", "rov7", "bluerov2_heavy"),
        ("archive/rov8/deep/b.csv", "rov8", "bluerov2_heavy"),
    }
    assert {each.vehicle for each in tasks_of(read(tmp_path, LOGS))} == {"rov7", "boat"}
    with pytest.raises(InputError, match=r"\[vehicle\] names no folder of archive/rov7/a\.csv; add one"):
        tasks_of(read(tmp_path, text + '[vehicle]\nboat = "vlbv300"\nrov8 = "vlbv300"\n'))


def test_two_vehicles_of_one_name_are_refused(tmp_path: Path) -> None:
    text = catalog_text("vlbv300")
    (tmp_path / "a.toml").write_text(text)
    (tmp_path / "b.toml").write_text(text.replace("mass = ", "mass = 1"))
    known = LOGS.replace('vehicle = "vlbv300"\n', "") + '[vehicle]\none = "a.toml"\n'
    read(tmp_path, known + 'two = "vlbv300"\n')
    with pytest.raises(InputError, match=r'vehicle\.two: "b\.toml" is another vehicle than that of vehicle\.one'):
        read(tmp_path, known + 'two = "b.toml"\n')


def test_the_hash_of_a_log_that_has_just_changed_is_not_kept(tmp_path: Path) -> None:
    where = log(tmp_path, "archive/rov7/a.csv")
    named(tmp_path, LOGS)
    assert not (tmp_path / "cache" / "digests.json").exists()
    os.utime(where, (1.0, 1.0))
    named(tmp_path, LOGS)
    assert len(json.loads((tmp_path / "cache" / "digests.json").read_text())) == 1


def named(folder: Path, text: str) -> dict[str, str]:
    return {task.label: task.id for task in tasks_of(read(folder, text))}


def test_a_task_has_another_name_for_other_content_configuration_vehicle_version_and_seed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    where = log(tmp_path, "archive/rov7/a.csv")
    [name] = named(tmp_path, LOGS).values()
    assert [name] == list(named(tmp_path, LOGS + "# a remark\n").values())
    others = [LEARN.format(method="paper"), LOGS + "delay = 0.1", LOGS + 'free = ["X_uu"]', LOGS + "keep_all = true"]
    others += [LOGS.replace("vlbv300", "bluerov2_heavy"), LOGS.replace('"learn"', '"validate"').replace("method", "#")]
    names = {name} | {each for text in others for each in named(tmp_path, text).values()}
    assert len(names) == 1 + len(others)
    where.write_text("t,u\n0,2\n")
    names |= set(named(tmp_path, LOGS).values())
    assert len(names) == 2 + len(others)
    where.write_text("t,u\n0,1\n")
    assert [name] == list(named(tmp_path, LOGS).values())
    monkeypatch.setattr("towtank.campaigns.tasks.Task.__init__.__defaults__", _with_version("9.9"))
    assert name not in named(tmp_path, LOGS).values()


def _with_version(version: str) -> tuple[object, ...]:
    defaults = Task.__init__.__defaults__ or ()
    return (*defaults[:-1], version)


def test_a_mapping_counts_by_what_it_says(tmp_path: Path) -> None:
    log(tmp_path, "archive/rov7/a.csv")
    (tmp_path / "map.toml").write_text('[columns]\nt = "t"\n')
    first = named(tmp_path, LOGS + 'map = "map.toml"')
    (tmp_path / "map.toml").write_text('[columns]\nt = "t"\nu = "u"\n')
    assert first != named(tmp_path, LOGS + 'map = "map.toml"')


def test_a_study_that_grows_keeps_the_names_of_the_runs_that_it_had(tmp_path: Path) -> None:
    few, many = (named(tmp_path, STUDY.format(runs=n, seed=1)) for n in (2, 4))
    assert few.items() <= many.items()
    assert len(set(many.values())) == 4
    assert not set(few.values()) & set(named(tmp_path, STUDY.format(runs=2, seed=2)).values())


def test_copies_of_a_log_are_done_once(tmp_path: Path) -> None:
    for name in ("a", "b"):
        log(tmp_path, f"archive/rov7/{name}.csv")
    assert list(named(tmp_path, LOGS)) == ["archive/rov7/a.csv"]


def test_what_is_remembered_of_a_log_is_forgotten_with_its_size_or_time(tmp_path: Path) -> None:
    where = log(tmp_path, "archive/rov7/a.csv")
    os.utime(where, (1.0, 1.0))
    [first] = named(tmp_path, LOGS).values()
    where.write_text("t,u\n0,3\n")
    os.utime(where, (2.0, 2.0))
    assert [first] != list(named(tmp_path, LOGS).values())
    (tmp_path / "cache" / "digests.json").write_text("{broken")
    where.write_text("t,u\n0,1\n")
    assert [first] == list(named(tmp_path, LOGS).values())
