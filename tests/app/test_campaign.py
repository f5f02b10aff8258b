"""`towtank campaign` from end to end, with simulated runs and a few logs that need no estimator to be refused."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from towtank.campaigns import Store
from towtank.vehicle import load_vehicle

from .commands import command, document, refused

sys.path.append(str(Path(__file__).parents[1] / "campaigns"))  # processes that are started import it too

from campaign_pieces import LEARN, STUDY, campaign, log


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of four simulated runs that two processes have done."""
    folder = tmp_path_factory.mktemp("study")
    path = campaign(folder, STUDY.format(runs=4, seed=1))
    ran = command("campaign", "run", path, "--store", folder / "two", "--engine", "local:2")
    assert ran.code == 0, ran
    return folder


def test_one_process_and_two_have_the_same_table_bit_for_bit(study: Path) -> None:
    ran = command("campaign", "run", study / "campaign.toml", "--store", study / "one", "--engine", "local:1")
    assert ran.code == 0, ran
    one, two = (Store.opened(str(study / name)) for name in ("one", "two"))
    assert one.table().drop(["seconds"]).equals(two.table().drop(["seconds"]))
    for each in two.models():
        assert each.load() == next(other for other in one.models() if other.id == each.id).load()
        assert each.learned_from() == load_vehicle("vlbv300")
        assert each.prior() is None
    assert [(each.klass, each.vehicle, each.label) for each in two.models()] == [
        ("vlbv300", "vlbv300-1", f"vlbv300-1/run-{k}") for k in (1, 2, 3, 4)
    ]


def test_a_table_has_a_row_for_each_coefficient_of_each_run(study: Path) -> None:
    found = document("campaign", "table", study / "two", "-o", study / "table.parquet")
    rows = pq.read_table(study / "table.parquet").to_pylist()
    assert found["rows"] == len(rows)
    assert (found["runs"], found["vehicles"]) == (4, 1)
    surge = [row for row in rows if row["coefficient"] == "X_uu"]
    assert len(surge) == 4
    assert len({row["truth"] for row in surge}) == 4
    for row in surge:
        assert row["identified"]
        assert abs(row["value"] / row["truth"] - 1.0) < 0.1
        assert row["fit_u"] > 80.0
    ran = command("campaign", "table", study / "two", "-o", study / "table.csv")
    assert "4 runs of 1 vehicle" in ran.out
    with (study / "table.csv").open() as stream:
        assert [row["run"] for row in csv.DictReader(stream)] == [row["run"] for row in rows]


def test_status_and_compact_say_what_there_is(study: Path) -> None:
    found = document("campaign", "status", study / "two")
    assert (found["tasks"], found["done"], found["left"], found["failed"]) == (4, 4, 0, [])
    before = Store.opened(str(study / "two")).table()
    assert document("campaign", "compact", study / "two")["files_after"] == 1
    assert Store.opened(str(study / "two")).table().equals(before)
    again = document("campaign", "run", study / "campaign.toml", "--store", study / "two")
    assert (again["performed"], again["done_before"]) == (0, 4)


def test_logs_that_fail_are_listed_with_the_line_that_learn_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TOWTANK_CACHE", str(tmp_path / "cache"))
    log(tmp_path, "archive/one/a.csv", "t,u\n0,1\n")
    log(tmp_path, "archive/one/b.csv", "nonsense")
    path = campaign(tmp_path, LEARN.format(method="paper"))
    ran = command("campaign", "run", path, "--store", "store", "--engine", "local:1")
    assert ran.code == 1, ran
    assert "2 failed" in ran.out
    found = document("campaign", "status", "store")
    assert [each["label"] for each in found["failed"]] == ["archive/one/a.csv", "archive/one/b.csv"]
    for each in found["failed"]:
        alone = refused("learn", tmp_path / each["label"], "--vehicle", "vlbv300", "--method", "paper")
        assert (each["line"], each["code"]) == (alone, 2)
    assert "Nothing is done yet" in command("campaign", "table", "store").out


@pytest.mark.parametrize(
    "words, said",
    [
        (("run", "campaign.toml", "--store", "store"), 'no log matches "archive/*/*.csv"'),
        (("run", "campaign.toml", "--store", "store", "--engine", "slurm"), "--engine: found"),
        (("run", "campaign.toml", "--store", "store", "--engine", "local:0"), "expected local:N with N processes"),
        (("run", "campaign.toml", "--store", "store", "--limit", "0"), "--limit: found 0, expected 1 or more"),
        (("run", "campaign.toml", "--store", "ftp://host/store"), "ftp://host/store: found ftp://, expected s3://"),
        (("status", "empty"), "holds no campaign; towtank campaign run CAMPAIGN.toml --store"),
        (("table", "empty", "-o", "table.txt"), '--output: found "table.txt", expected a name that ends in .parquet'),
        (("compact", "empty"), "holds no campaign"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    campaign(tmp_path, LEARN.format(method="joint"))
    assert said in refused("campaign", *words)


def test_a_scheduler_needs_the_library_of_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    path = campaign(tmp_path, STUDY.format(runs=1, seed=1))
    words = ("campaign", "run", path, "--store", tmp_path / "store", "--engine", "tcp://127.0.0.1:1")
    assert (
        'needs the library distributed, which is not installed; install it with pip install "towtank[fleet]"'
        in refused(*words)
    )
