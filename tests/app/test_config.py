"""`towtank config ...`."""

from __future__ import annotations

from pathlib import Path

import pytest

from towtank.vehicle import Coefficient, Configurations, load_vehicle, save_vehicle

from .commands import command, document, refused


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A folder with `bare.toml` and `gripper.toml`."""
    vehicle = load_vehicle("bluerov2_heavy")

    def given(value: float, std: float) -> Coefficient:
        return Coefficient(value=value, std=std)

    bare = {"Z_wdot": given(-19.0, 0.2), "X_uu": given(-34.0, 1.2), "W_minus_B": given(-1.0, 0.1)}
    more = {"Z_wdot": given(-21.1, 0.2236), "X_uu": given(-35.0, 1.2), "W_minus_B": given(4.1, 0.3)}
    save_vehicle(vehicle.with_coefficients(bare), tmp_path / "bare.toml")
    save_vehicle(vehicle.with_coefficients(more), tmp_path / "gripper.toml")
    return tmp_path


@pytest.fixture
def stored(models: Path) -> Path:
    folder = models / "configurations"
    for name, note in (("bare", "as delivered"), ("gripper", "")):
        ran = command("config", "save", models / f"{name}.toml", "--name", name, "--note", note, "--folder", folder)
        assert ran.code == 0, ran
    return folder


def test_save_copies_the_file_and_says_where(models: Path) -> None:
    folder = models / "c"
    found = document(
        "config", "save", models / "bare.toml", "--name", "with Gripper", "--note", "n",
        "--log", models / "gripper.toml", "--folder", folder,
    )  # fmt: skip
    assert (folder / "with-gripper.toml").read_bytes() == (models / "bare.toml").read_bytes()
    assert found["name"] == "with Gripper"
    assert found["file"] == str(folder / "with-gripper.toml")
    assert (found["note"], found["changed"]) == ("n", False)
    assert found["logs"][0]["name"] == "gripper.toml"
    assert found["towtank"]
    assert found["saved"].endswith("+00:00")


def test_list(stored: Path) -> None:
    ran = command("config", "list", "--folder", stored)
    assert ran.code == 0
    assert "as delivered" in ran.out
    assert "net weight W - B +5.10 ± 0.32 N (16 std)" in " ".join(ran.out.split())
    assert max(map(len, ran.out.splitlines())) <= 80
    with (stored / "gripper.toml").open("a") as file:
        file.write("# by hand\n")
    assert "changed since it was saved" in command("config", "list", "--folder", stored).out
    entries = document("config", "list", "--folder", stored)["configurations"]
    assert [(entry["name"], entry["changed"]) for entry in entries] == [("bare", False), ("gripper", True)]
    assert entries[0]["differs_most"] == []
    assert entries[1]["differs_most"][0]["name"] == "W_minus_B"


def test_list_of_nothing(tmp_path: Path) -> None:
    ran = command("config", "list", "--folder", tmp_path / "none")
    assert ran.code == 0
    assert "no configurations" in ran.out
    assert document("config", "list", "--folder", tmp_path / "none")["configurations"] == []


def test_show(stored: Path) -> None:
    ran = command("config", "show", "bare", "--folder", stored)
    assert ran.code == 0
    assert "as delivered" in ran.out
    assert "Coefficients" in ran.out
    found = document("config", "show", "bare", "--folder", stored)
    assert found["base"] == "bluerov2_heavy"
    assert found["vehicle"]["coefficients"]["W_minus_B"]["std"] == 0.1


def test_compare_in_words_and_numbers(stored: Path) -> None:
    ran = command("config", "compare", "bare", "gripper", "--folder", stored)
    assert ran.code == 0, ran
    assert "heave inertia +2.10 ± 0.30 kg (7.0 std)" in ran.out
    assert "net weight W - B +5.10 ± 0.32 N (16 std)" in ran.out
    assert "surge quadratic drag" not in ran.out.split("deviations")[-1]
    assert "all together they differ significantly" in ran.out
    assert max(map(len, ran.out.splitlines())) <= 80
    found = document("config", "compare", "bare", "gripper", "bare", "--folder", stored)
    one, same = found["comparisons"]
    assert found["base"]["name"] == "bare"
    assert one["quantities"]["M_Z"]["difference"] == pytest.approx(2.1)
    assert one["quantities"]["M_Z"]["significant"]
    assert not one["quantities"]["X_uu"]["significant"]
    assert (one["degrees"], one["significant"]) == (3, True)
    assert (same["chi_square"], same["p"], same["significant"]) == (0.0, 1.0, False)


def test_bad_input_is_one_line(stored: Path, models: Path, tmp_path: Path) -> None:
    assert 'no configuration "gripe"; did you mean "gripper"?' in refused("config", "show", "gripe", "--folder", stored)
    assert "there are bare, gripper" in refused("config", "compare", "bare", "x", "--folder", stored)
    assert "is there already" in refused("config", "save", models / "bare.toml", "--name", "BARE", "--folder", stored)
    assert "name: found" in refused("config", "save", models / "bare.toml", "--name", "..", "--folder", stored)
    assert "no such file" in refused("config", "save", models / "x.toml", "--name", "x", "--folder", stored)
    assert "it holds none yet" in refused("config", "show", "x", "--folder", tmp_path / "none")
    assert "expected a folder" in refused("config", "list", "--folder", models / "bare.toml")
    assert "--name" in refused("config", "save", models / "bare.toml", "--folder", stored)
    assert "missing argument" in refused("config", "compare", "bare", "--folder", stored)
    (stored / "gripper.toml").write_text("mass = \nname = 3\n")
    assert "gripper.toml:1:" in refused("config", "list", "--folder", stored)


def test_the_folder_is_that_of_the_environment_or_the_usual_one(models: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TOWTANK_CONFIGURATIONS", raising=False)
    monkeypatch.chdir(models)
    assert command("config", "save", models / "bare.toml", "--name", "a").code == 0
    assert Configurations(models / "configurations").get("a").name == "a"
    elsewhere = models / "elsewhere"
    monkeypatch.setenv("TOWTANK_CONFIGURATIONS", str(elsewhere))
    ran = command("config", "save", "bare.toml", "--name", "b")
    assert ran.code == 0, ran
    assert [each.name for each in Configurations(elsewhere).all()] == ["b"]
