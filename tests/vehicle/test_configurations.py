"""Configurations: a folder of vehicle files with names, whatever happens to it; and what differs between models."""

from __future__ import annotations

import hashlib
import multiprocessing
import warnings
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.vehicle import Coefficient, Configurations, Vehicle, differences, load_vehicle, save_vehicle
from towtank.vehicle.configurations import slug

seamor = cache(partial(load_vehicle, "seamor"))


def rov(**more: float | Coefficient) -> Vehicle:
    return seamor().with_coefficients(more)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "configurations"


def test_what_is_saved_comes_back(folder: Path, tmp_path: Path) -> None:
    stored = Configurations(folder)
    assert stored.all() == ()
    model, log = tmp_path / "model.toml", tmp_path / "dive.csv"
    save_vehicle(rov(X_uu=-80.0), model)
    text = f"# by hand\n{model.read_text()}"
    model.write_text(text)
    log.write_bytes(b"t,x\n" * 700_000)
    before = datetime.now(UTC).replace(microsecond=0)
    saved = stored.save(model, "With gripper, 2 kg", note='the "big" one\n# two', logs=[log], version="1.2.3")
    assert saved.path == folder / "with-gripper-2-kg.toml"
    assert saved.path.read_text() == text
    found = Configurations(str(folder)).get("With gripper, 2 kg")
    assert found == saved == stored.get("with-gripper-2-kg") == stored.get("with-gripper-2-kg.toml")
    assert found.vehicle == rov(X_uu=-80.0)
    assert (found.note, found.version, found.changed) == ('the "big" one\n# two', "1.2.3", False)
    assert found.saved is not None
    assert before <= found.saved <= datetime.now(UTC)
    assert found.logs[0].name == "dive.csv"
    assert found.logs[0].sha256 == hashlib.sha256(log.read_bytes()).hexdigest()
    assert found.sha256 == hashlib.sha256(text.encode()).hexdigest()


def test_a_vehicle_or_a_name_of_the_catalog_is_saved_too(folder: Path) -> None:
    stored = Configurations(folder)
    stored.save("seamor", "bare")
    stored.save(rov(W_minus_B=4.0), "heavy")
    assert [each.name for each in stored.all()] == ["bare", "heavy"]
    assert stored.get("bare").vehicle == load_vehicle("seamor")
    assert stored.get("heavy").vehicle.weight_minus_buoyancy == 4.0


def test_the_index_is_made_anew_and_hand_edits_are_seen(folder: Path) -> None:
    stored = Configurations(folder)
    for name in ("one", "two", "three"):
        stored.save("seamor", name, note=f"note {name}")
    (folder / "two.toml").unlink()
    save_vehicle(rov(X_uu=-99.0), folder / "one.toml")
    save_vehicle(rov(), folder / "brought.toml")
    found = {each.name: each for each in stored.all()}
    assert list(found) == ["one", "three", "brought"]
    assert found["one"].changed
    assert found["one"].note == "note one"
    assert found["one"].vehicle.coefficient("X_uu") == -99.0
    assert not found["three"].changed
    assert (found["brought"].saved, found["brought"].changed) == (None, False)
    (folder / "index.toml").unlink()
    assert [each.name for each in stored.all()] == ["brought", "one", "three"]
    stored.save("seamor", "four")
    assert [each.name for each in stored.all()] == ["brought", "one", "three", "four"]


@pytest.mark.parametrize(
    "name", ["", " ", "..", "/", "---", "日本", " bare", "a\nb", "a\x00b", "x" * 81, "Index", "index"]
)
def test_names_that_are_none_are_refused(folder: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"name: found"):
        Configurations(folder).save("seamor", name)
    assert not folder.exists()


@pytest.mark.parametrize(
    "name", ["../../evil", "/etc/passwd", "C:\\boot", "..\\up", "a/../../b", "naïve Größe", "CON fig"]
)
def test_no_name_leads_out_of_the_folder(folder: Path, name: str) -> None:
    saved = Configurations(folder).save("seamor", name)
    assert saved.path.parent == folder
    assert sorted(path.name for path in folder.parent.iterdir()) == ["configurations"]
    assert Configurations(folder).get(name) == saved
    assert set(slug(name)) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")


def test_names_are_unique_by_their_files_too(folder: Path) -> None:
    stored = Configurations(folder)
    first = stored.save("seamor", "with gripper")
    for name in ("with gripper", "With Gripper", "with-gripper!"):
        with pytest.raises(InputError, match="is there already"):
            stored.save(rov(X_uu=-1.0), name)
    assert stored.all() == (first,)


def test_a_bad_model_or_log_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    stored = Configurations(folder)
    bad = tmp_path / "bad.toml"
    bad.write_text('name = "x"\n[rigid_body]\nmass = -1.0\ninertia = [1.0, 1.0, 1.0]\n')
    with pytest.raises(InputError, match=r"bad\.toml: .*mass"):
        stored.save(bad, "x")
    bad.write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not UTF-8"):
        stored.save(bad, "x")
    with pytest.raises(InputError, match=r"none\.csv: cannot be read"):
        stored.save("seamor", "x", logs=[tmp_path / "none.csv"])
    with pytest.raises(InputError, match="neither a file nor a vehicle"):
        stored.save("seamoor", "x")
    assert not folder.exists()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("configuration = 3", "index.toml"),
        ("[[configuration]]\nname = 'a'\nfile = '../a.toml'\n", "the name of a vehicle file in this folder"),
        ("[[configuration]]\nname = 'a'\nfile = 'a.toml'\nsaved = 'now'\n", "expected a date"),
        ("[[configuration]]\nname = 'a'\nfile = 'a.toml'\nnotes = 'b'\n", "notes"),
        ("[[configuration]]\nname = 'a'\nfile = 'a.toml'\n" * 2, "twice"),
        ("[[configuration", "delete it"),
    ],
)
def test_a_broken_index_says_what_to_do(folder: Path, text: str, told: str) -> None:
    folder.mkdir()
    (folder / "index.toml").write_text(text)
    with pytest.raises(InputError, match=told):
        Configurations(folder).all()


def test_a_file_in_place_of_the_folder_is_told(folder: Path) -> None:
    folder.write_text("")
    with pytest.raises(InputError, match="expected a folder"):
        Configurations(folder).all()
    with pytest.raises(InputError, match="configurations"):
        Configurations(folder).save("seamor", "x")


def _save_some(folder: Path, who: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for k in range(6):
            Configurations(folder).save("seamor", f"by {who} number {k}")


def test_saving_at_once_loses_nothing(folder: Path) -> None:
    context = multiprocessing.get_context("spawn")
    workers = [context.Process(target=_save_some, args=(folder, who)) for who in range(2)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
        assert worker.exitcode == 0
    names = {each.name for each in Configurations(folder).all()}
    assert names == {f"by {who} number {k}" for who in range(2) for k in range(6)}
    assert all(each.saved for each in Configurations(folder).all())


def given(value: float, std: float) -> Coefficient:
    return Coefficient(value=value, std=std)


def test_differences_are_counted_in_deviations() -> None:
    base = rov(X_uu=given(-60.0, 3.0), W_minus_B=given(0.0, 0.3), Y_v=-1.0)
    other = rov(X_uu=given(-75.0, 4.0), W_minus_B=given(0.5, 0.4), Y_v=-2.0)
    found = differences(base, other)
    by_name = {each.name: each for each in found.quantities}
    assert by_name["X_uu"].std == pytest.approx(5.0)
    assert by_name["X_uu"].deviations == pytest.approx(3.0)
    assert by_name["W_minus_B"].deviations == pytest.approx(1.0)
    assert by_name["Y_v"].deviations is None
    assert by_name["Y_v"].significant is None
    assert (found.chi_square, found.degrees) == (pytest.approx(10.0), 2)
    assert found.p == pytest.approx(np.exp(-5.0))
    assert found.significant
    assert [each.name for each in found.largest] == ["X_uu", "W_minus_B", "Y_v"]
    assert differences(base, base).p == 1.0
    assert differences(base, base).largest == ()


def test_inertias_are_totals() -> None:
    base = rov(Z_wdot=given(-30.0, 0.3))
    heavy = rov(Z_wdot=given(-30.0, 0.4))
    body = heavy.rigid_body.model_copy(update={"mass": heavy.rigid_body.mass + 2.0})
    found = {each.name: each for each in differences(base, heavy.model_copy(update={"rigid_body": body})).quantities}
    assert found["M_Z"].difference == pytest.approx(2.0)
    assert found["M_Z"].deviations == pytest.approx(4.0)
    assert found["M_Z"].text == "heave inertia"
    assert found["M_X"].difference == pytest.approx(2.0)
    assert "Z_wdot" not in found


def test_without_deviations_there_is_no_verdict() -> None:
    found = differences(rov(), rov(X_uu=-1.0))
    assert (found.p, found.significant, found.degrees) == (None, None, 0)
    assert found.largest[0].name == "X_uu"


def test_equal_models_are_rarely_called_different() -> None:
    """Two estimates of one truth, 1000 times: about 1 % beyond the chi-square's level."""
    rng = np.random.default_rng(0)
    names = ("X_uu", "Y_vv", "Z_ww", "W_minus_B")
    called = 0
    for _ in range(1000):
        one, two = (rov(**{name: given(-50.0 + 2.0 * rng.normal(), 2.0) for name in names}) for _ in range(2))
        called += bool(differences(one, two).significant)
    assert 2 <= called <= 22


def test_thrusters_that_give_something_else_are_a_difference_without_a_verdict() -> None:
    base = load_vehicle("bluerov_2016")
    weaker = tuple(each.model_copy(update={"gain": 0.6} if each.name == "f3" else {}) for each in base.thrusters)
    found = differences(base, base.model_copy(update={"thrusters": weaker}))
    (only,) = found.largest
    assert (only.name, only.text, only.base, only.other) == ("gain_f3", "gain of thruster f3", 1.0, 0.6)
    assert only.significant is None
