"""The shape of the source: how many files, lines, names and parameters there are, and how deep imports go.

A limit is raised only with a reason in `docs/design/`; it is lowered whenever there is room.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from pkgutil import iter_modules

import pytest

import towtank

SOURCE = Path(towtank.__file__).parent
MOST_FILES, MOST_IN_A_FOLDER = 440, 12
IDENTIFICATION = {"files": 62, "lines": 15_450, "public names": 250, "functions of many parameters": 8, "depth": 9}
MANY = 8  # parameters
MOST_OF_A_KIND = 8  # files that know one kind of coefficient by name; what an exporter can say is its own affair
KINDS = {  # names and strings by which a file knows a kind, and files in which one of these means something else
    "asymmetric drag": (
        r"_?(I_)?(ASYMMETRY|asymmetry|asymmetric)(_\w+)?|[XYZKMN]_[uvwpqr]2",
        {"towtank.vehicle.thrusters.fit", "towtank.app.tables.thrusters"},  # force ahead and astern
    ),
    "forward-speed terms": (
        r"_?(I_|N_)?FORWARD(_\w+)?|forward_speed(_\w+)?|'forward'|[XYZKMN]_u[vwpqr]",
        {"towtank.app.tables.thrusters", "towtank.live.session", "towtank.planning.coach"},  # a direction
    ),
}
MOST_FOR_A_SENSOR = 6  # files that change for one more; formats of others, in the families of readers, beside
WATER_SPEED = re.compile(
    r"\b[uvw]_w\b|relative_velocity|water_?(velocity|track)|(velocity|speed) through the water|ins-water|^15:18$", re.I
)


@cache
def modules() -> dict[str, ast.Module]:
    """Every module by its dotted name, parsed."""
    names = {}
    for path in sorted(SOURCE.rglob("*.py")):
        parts = path.relative_to(SOURCE).with_suffix("").parts
        names[".".join(("towtank", *parts)).removesuffix(".__init__")] = ast.parse(path.read_text(encoding="utf-8"))
    return names


@cache
def words(name: str) -> frozenset[str]:
    """Every name, string and slice of a module, each once."""
    return frozenset(_words(modules()[name]))


def identification() -> dict[str, ast.Module]:
    return {name: tree for name, tree in modules().items() if name.startswith("towtank.identification")}


def imports(name: str) -> set[str]:
    """Modules of towtank that a module imports when it is imported itself; not those for type checkers or on use."""
    found = set()
    for node in modules()[name].body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("towtank"):
            inside = {f"{node.module}.{each.name}" for each in node.names} & modules().keys()
            found |= inside or {str(node.module)}
    return found - {name}


@cache
def depth(name: str, above: tuple[str, ...] = ()) -> int:
    """Length of the longest chain of imports within identification that begins with a module."""
    if name in above:
        raise AssertionError(f"a cycle of imports: {' -> '.join((*above[above.index(name) :], name))}")
    inside = [each for each in imports(name) if each.startswith("towtank.identification.")]
    return 1 + max((depth(each, (*above, name)) for each in inside), default=0)


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return len([each for each in given if each.arg not in ("self", "cls")])


def test_the_source_has_no_more_files_than_one_can_know() -> None:
    assert len(modules()) <= MOST_FILES


def test_a_folder_holds_at_most_a_dozen_files() -> None:
    folders = {path.parent for path in SOURCE.rglob("*.py")}
    crowded = {f"{each.relative_to(SOURCE)}": len(list(each.glob("*.py"))) for each in folders}
    assert {name: n for name, n in crowded.items() if n > MOST_IN_A_FOLDER} == {}


def test_three_files_of_one_prefix_are_a_folder() -> None:
    prefixes: dict[tuple[str, str], list[str]] = {}
    for name in modules():
        package, _, last = name.rpartition(".")
        if "_" in last.strip("_"):
            prefixes.setdefault((package, last.split("_")[0]), []).append(last)
    assert {key: found for key, found in prefixes.items() if len(found) > 2} == {}


def test_identification_stays_small() -> None:
    lines = sum(
        len(path.read_text(encoding="utf-8").splitlines()) for path in (SOURCE / "identification").rglob("*.py")
    )
    public = [each for tree in identification().values() for each in _exported(tree)]
    assert len(identification()) <= IDENTIFICATION["files"]
    assert lines <= IDENTIFICATION["lines"]
    assert len(public) <= IDENTIFICATION["public names"]


def test_what_travels_together_is_a_record() -> None:
    crowded = [
        f"{name}.{node.name}: {parameters(node)}"
        for name, tree in identification().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and parameters(node) > MANY
    ]
    assert len(crowded) <= IDENTIFICATION["functions of many parameters"], crowded


def test_chains_of_imports_in_identification_are_short_and_end() -> None:
    assert max(depth(name) for name in identification() if name.count(".") > 1) <= IDENTIFICATION["depth"]


@pytest.mark.parametrize("package", sorted(f"towtank.{each.name}" for each in iter_modules([str(SOURCE)])))
def test_no_package_imports_in_circles(package: str) -> None:
    inside = {name for name in modules() if name.startswith(f"{package}.")}
    graph = {name: imports(name) & inside for name in inside}
    while leaves := {name for name, needed in graph.items() if not needed & graph.keys()}:
        graph = {name: needed for name, needed in graph.items() if name not in leaves}
    assert graph == {}


def test_no_assert_stands_for_a_type_in_the_source() -> None:
    found = [name for name, tree in modules().items() if any(isinstance(node, ast.Assert) for node in ast.walk(tree))]
    assert found == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_of_coefficient_is_known_by_name_in_few_files(kind: str) -> None:
    """So many would have to change for a further one; all others read the tables of kinds."""
    known, elsewhere = KINDS[kind]
    found = {
        name
        for name in modules()
        if not name.startswith("towtank.exporters") and any(re.fullmatch(known, word) for word in words(name))
    }
    assert elsewhere <= found  # or they need not be named above
    assert len(found - elsewhere) <= MOST_OF_A_KIND, sorted(found - elsewhere)
    assert {"towtank.core.forces", "towtank.vehicle.names", "towtank.identification.model.terms"} <= found


def test_a_sensor_is_known_by_name_in_six_files() -> None:
    """Velocity through the water stands for any: files that name it, its channels or its columns, but in docstrings."""
    own = [name for name in modules() if not name.startswith("towtank.readers.") or "readers.common" in name]
    known = sorted(name for name in own if any(WATER_SPEED.search(word) for word in words(name)))
    assert "towtank.recording.standard" in known
    assert len(known) <= MOST_FOR_A_SENSOR, known


def _words(tree: ast.Module) -> Iterator[str]:
    """Yield every name, string and slice of a module, docstrings left out; a string bare and in quotes."""
    said = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if node not in said:
            words = [value for _, value in ast.iter_fields(node) if isinstance(value, str)]
            yield from words
            if isinstance(node, ast.Constant):
                yield from (f"'{word}'" for word in words)
        if isinstance(node, ast.Slice):
            yield ast.unparse(node)


def _exported(tree: ast.Module) -> list[str]:
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return list(ast.literal_eval(node.value))
    return []
