"""The report of `towtank learn`: what is in it, that its numbers are those of --json, and odd cases."""

from __future__ import annotations

import csv
import hashlib
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from towtank.identification import learn_recordings
from towtank.readers import read
from towtank.report import LearnFacts
from towtank.report.learn_page import report_html
from towtank.vehicle import load_vehicle

from .conftest import Made
from .pages import Page, numbers_agree, run

SECTIONS = ["coefficients", "held", "prediction", "residuals", "convergence", "identifiability", "input", "log"]
WORDS = ("learn", "--vehicle", "vlbv300")


def test_it_stands_alone(learned: Made) -> None:
    learned.page.self_contained()
    assert learned.path.stat().st_size < 500_000
    assert str(learned.path.parent) not in learned.page.html.replace("towtank learn", "").split("<h2>How to make")[0]


def test_every_section_is_there(learned: Made) -> None:
    always = [name for name in learned.page.sections if name not in ("warnings", "findings")]
    assert always == [*SECTIONS, "vehicle", "how", "origin"]
    assert 'class="plan"' in learned.page.html
    assert 'class="heat"' in learned.page.html
    assert learned.page.html.count('class="chart"') >= 3 * len([f for f in learned.document["fit"].values() if f]) // 2


def test_every_number_is_that_of_json(learned: Made) -> None:
    keys = numbers_agree(learned.page, learned.document)
    assert {"delay_s", "delay_std_s", "duration_s", "samples"} <= keys
    for name, entry in learned.document["coefficients"].items():
        assert f"coefficients/{name}/value" in keys
        if entry["identified"]:
            fields = ("std", "interval/0", "interval/1", "prior/value", "prior/std")
            assert {f"coefficients/{name}/{field}" for field in fields} <= keys
    assert {f"latency_s/{name}/{field}" for name in learned.document["latency_s"] for field in ("value", "std")} <= keys
    assert {f"fit/{name}" for name, value in learned.document["fit"].items() if value is not None} <= keys
    assert {f"rmse/{name}" for name, value in learned.document["rmse"].items() if value is not None} <= keys
    assert {f"sums/{name}/std" for name in learned.document["sums"]} <= keys
    assert {f"disturbance/{name}/std" for name in learned.document["disturbance"]} <= keys


def test_the_prior_stands_beside_what_was_learned(learned: Made) -> None:
    text = learned.page.text
    assert "“Prior” is what was supposed before any data" in text
    assert "Before" not in text
    assert "Sensors that are late" in text


def test_reasons_and_meanings_are_told(learned: Made) -> None:
    text = learned.page.text
    assert "Added inertia: yaw moment per yaw acceleration" in text
    assert "would narrow it" in text
    assert "not identified" in text
    assert text.index("inertia to") < text.index("Coefficients")


def test_how_to_make_it_again(learned: Made, logs: Path) -> None:
    assert hashlib.sha256((logs / "yaw.csv").read_bytes()).hexdigest() in learned.page.html
    assert f"towtank learn {logs / 'yaw.csv'} --vehicle vlbv300 -o {logs / 'learned.toml'}" in learned.page.html
    assert "numba" in learned.page.text


@pytest.mark.parametrize("method", ["joint", "output-error", "paper"])
def test_every_method(method: str, make: Any, logs: Path) -> None:
    made = make(method, *WORDS, logs / "yaw.csv", "--method", method, "--free", "N_rdot,N_rr", "--window", "0,8")
    numbers_agree(made.page, made.document)
    assert made.page.html.count('over time"') >= 2
    assert "convergence" in made.page.sections
    assert f"--method {method}" in made.page.html or method == "joint"


def test_several_logs(make: Any, logs: Path) -> None:
    made = make("two", *WORDS, logs / "yaw.csv", logs / "surge.csv", "--delay", 0, "--method", "paper")
    numbers_agree(made.page, made.document)
    made.page.self_contained()
    assert made.page.html.count("<h3>yaw.csv</h3>") == 2  # drawn, and told of its quality
    assert 'class="cut"' in made.page.html
    assert "given" in made.page.text


@pytest.fixture(scope="module")
def gyro(logs: Path) -> Path:
    """The yaw run with its yaw rate alone."""
    with (logs / "yaw.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    kept = ["t", "r", *(name for name in rows[0] if name.startswith("cmd_"))]
    with (logs / "gyro.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, kept, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    return logs / "gyro.csv"


def test_nothing_can_be_identified(make: Any, gyro: Path) -> None:
    made = make("nothing", *WORDS, gyro, "--method", "paper", "--free", "X_udot,X_uu", "--delay", 0)
    numbers_agree(made.page, made.document)
    assert "Nothing could be identified: surge speed u is not measured" in made.page.text
    assert "convergence" not in made.page.sections
    assert "identifiability" not in made.page.sections
    assert "held" in made.page.sections


def test_channels_are_missing(make: Any, gyro: Path) -> None:
    made = make("gyro_only", *WORDS, gyro, "--method", "paper")
    numbers_agree(made.page, made.document)
    assert made.page.text.count("is not measured in these recordings") >= 5
    assert {key for key, _, _ in made.page.numbers if key.startswith("fit/")} == {"fit/r"}


def test_a_planar_vehicle_without_thrusters(tmp_path: Path) -> None:
    log = tmp_path / "boat.csv"
    run("simulate", "blueboat", "surge-square", "-o", log, "--duration", 8, "--sensors", "ins", "--seed", 1)
    path = tmp_path / "boat.html"
    document = run("learn", log, "--vehicle", "blueboat", "--method", "paper", "--delay", 0, "--report", path)
    page = Page(path.read_text(encoding="utf-8"))
    page.self_contained()
    numbers_agree(page, document)
    driven = {name: value for name, value in document["fit"].items() if value is not None}
    assert {"u", "r"} <= driven.keys()
    assert {key for key, _, _ in page.numbers if key.startswith("fit/")} >= {"fit/u", "fit/r"}


def test_only_what_a_live_session_has(logs: Path) -> None:
    vehicle = load_vehicle("vlbv300")
    learning = learn_recordings(vehicle, [read(logs / "yaw.csv")], method="paper", free=["N_rdot", "N_rr"], delay=0.0)
    facts = LearnFacts(vehicle=vehicle, model=learning.model, estimate=learning.estimate)
    page = Page(report_html(facts))
    page.self_contained()
    assert page.sections == ["coefficients", "identifiability", "input", "vehicle"]
    assert report_html(facts) == page.html
    assert "not known yet" in page.text
    assert math.isnan(facts.delay)
    late = replace(facts, delay=0.0746, delay_std=0.0061, lag=0.0056, lag_std=0.0061, together=(0.0802, 0.0003))
    assert "80.20 ± 0.30 ms; how much of that is lag is less sure" in Page(report_html(late)).text
    assert "less sure" not in Page(report_html(replace(late, together=(0.0802, 0.004)))).text


def test_names_cannot_break_the_page(logs: Path) -> None:
    vehicle = load_vehicle("vlbv300").model_copy(update={"name": "<b>&\"'", "description": "<script>1</script>"})
    learning = learn_recordings(vehicle, [read(logs / "yaw.csv")], method="paper", free=["N_rdot", "N_rr"], delay=0.0)
    facts = LearnFacts(vehicle, learning.model, learning.estimate, warnings=["<img src=x>"], remarks=["a < b & c"])
    page = Page(report_html(facts))
    page.self_contained()
    assert "&lt;img src=x&gt;" in page.html
    assert "img" not in page.elements


def test_the_real_yaw_run(data: Path, tmp_path: Path) -> None:
    runs = sorted((data / "bluerov_pool_2016").glob("yaw_1_2016*.csv"))
    if not runs:
        pytest.skip("the pool runs are not there")
    mapping, path = tmp_path / "map.toml", tmp_path / "r.html"
    columns = '[columns]\np = "gyro_p"\nq = "gyro_q"\nr = "gyro_r"\n'
    mapping.write_text('thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]\n' + columns)
    document = run("learn", runs[0], "--vehicle", "bluerov_2016", "--map", mapping, "--report", path)
    page = Page(path.read_text(encoding="utf-8"))
    page.self_contained()
    keys = numbers_agree(page, document)
    assert {f"coefficients/{name}/value" for name in document["coefficients"]} <= keys
    assert path.stat().st_size < 300_000
