"""What holds for every target: one vehicle gives the same bytes, opens with its heading, and has a page."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest
from tests.exporters.whole import whole_vehicle

from towtank import InputError, export, load_vehicle
from towtank.exporters import TARGETS
from towtank.vehicle import Coefficient

NAMES = [each.name for each in TARGETS]
PAGES = Path(__file__).resolve().parents[2] / "docs" / "export"


def texts(path: Path) -> list[str]:
    """What of a file can be read: itself, or the text files in an archive."""
    if path.suffix == ".fmu":
        with zipfile.ZipFile(path) as archive:
            return [archive.read(name).decode() for name in archive.namelist() if name.endswith((".c", ".h", ".xml"))]
    return [path.read_bytes().decode("latin-1")]


@pytest.mark.parametrize("name", NAMES)
def test_the_same_model_gives_the_same_bytes_that_say_where_they_come_from(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        monkeypatch.chdir(tmp_path / folder)
        done = export(whole_vehicle(), name)
        found.append({each: each.read_bytes() for each in done.files})
    assert found[0] == found[1]
    for place in found[0]:
        said = "\n".join(texts(tmp_path / "b" / place))
        assert f"towtank: {name} {done.version}" in said
        assert f"sha256 {done.heading.sha256}" in said
        assert "X_udot = " in said
        assert done.heading.error[:40] in said
    if name != "matlab":  # its heading is a variable
        assert all("towtank: " in "\n".join(texts(tmp_path / "b" / each))[:4000] for each in found[0] if name != "fmu")


def test_targets_do_not_overwrite_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    places = [place for name in NAMES for place in export("lauv", name).files]
    assert len(set(places)) == len(places)


@pytest.mark.parametrize("name", NAMES)
def test_every_target_has_a_page_that_says_how_it_was_proved(name: str) -> None:
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert f"--to {name}" in page
    assert "**Traps.**" in page
    assert "**How it was proved.**" in page


@pytest.mark.parametrize("name", NAMES)
def test_no_target_takes_a_mass_matrix_that_gains_energy(name: str, tmp_path: Path) -> None:
    vehicle = load_vehicle("lauv")
    heavy = {**vehicle.hydrodynamics, "Y_rdot": Coefficient(value=60.0)}
    broken = vehicle.model_copy(update={"hydrodynamics": type(vehicle.hydrodynamics)(heavy)})
    with pytest.raises(InputError, match="not positive definite"):
        export(broken, name, tmp_path)
