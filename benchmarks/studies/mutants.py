"""Mutants of source code: places where one operator, number, word or decorator is replaced by another.

The replacements are those of Cosmic Ray. What it would change without changing what the program does is not drawn:
annotations, aliases of types, `__all__`, blocks for type checkers, the marks of a signature (`*`, `/`), `strict=True`
(of sequences that have one length), and what is logged; docstrings it leaves alone. Bodies of compiled kernels are not
drawn either: each of their mutants is compiled anew for half a minute, and kernels have tests of their own
(`make kernels`).

A place counts once, however many replacements there are for it: of the eleven that Cosmic Ray has for a `+`, nearly
all fail at the same test, and a sample of mutants instead of places would be full of them.
"""

from __future__ import annotations

import ast
import random
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import parso
from cosmic_ray.ast import ast_nodes
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.provider import OperatorProvider

__all__ = ["Mutant", "Place", "draw", "places"]

_OPERATORS = OperatorProvider()
_KINDS = (  # the beginning of an operator's name, and what such mutants are called in tables
    ("ReplaceBinaryOperator", "arithmetic"),
    ("ReplaceComparisonOperator", "comparison"),
    ("ReplaceUnaryOperator", "sign or not"),
    ("AddNot", "condition negated"),
    ("ReplaceTrue", "True or False"),
    ("ReplaceFalse", "True or False"),
    ("ReplaceAnd", "and or or"),
    ("ReplaceOr", "and or or"),
    ("ReplaceBreak", "break or continue"),
    ("ReplaceContinue", "break or continue"),
    ("ExceptionReplacer", "exception not caught"),
    ("NumberReplacer", "number by one"),
    ("RemoveDecorator", "decorator removed"),
    ("ZeroIteration", "loop left out"),
)
_FAMILIES = ({"Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow"}, {"RShift", "LShift", "BitOr", "BitAnd", "BitXor"})
_Position = tuple[int, int]  # line from 1, column from 0


@dataclass(frozen=True)
class Place:
    """One place in a file that can be replaced.

    Attributes:
        file: path in the repository. begin: line (from 1) and column (from 0). kind: one of the words of the table.
        operators: name in Cosmic Ray and occurrence in the file, one for each replacement.
    """

    file: str
    begin: _Position
    kind: str
    operators: tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Mutant:
    """A file with one replacement.

    Attributes:
        place: where. operator: name in Cosmic Ray. source: the whole file. before, after: the line that differs,
            after is empty where it is left out.
    """

    place: Place
    operator: str
    source: str
    before: str
    after: str


def places(file: str, source: str) -> list[Place]:
    """Return the places of a file that may be drawn, in order."""
    tree = ast.parse(source)
    lines = source.splitlines()
    left_out = [_span(each, lines) for each in _without_effect(tree)]
    found: dict[tuple[_Position, str], list[tuple[str, int]]] = {}
    nodes = list(ast_nodes(parso.parse(source)))
    marks = {node.start_pos for node in nodes if node.type == "operator" and node.parent.type == "parameters"}
    for name, kind in _named_operators():
        operator = _OPERATORS[name]()
        positions = [position for node in nodes for position, _ in operator.mutation_positions(node)]
        for occurrence, begin in enumerate(positions):
            if begin not in marks and not any(first <= begin < last for first, last in left_out):
                found.setdefault((begin, kind), []).append((name, occurrence))
    return [Place(file, begin, kind, tuple(found[begin, kind])) for begin, kind in sorted(found)]


def draw(root: Path, files: Sequence[str], number: int, seed: int) -> list[Mutant]:
    """Return mutants of `number` places of these files, each place at most once, in the order drawn.

    Every place is as likely as any other, and so is every replacement of a place. Replacements that are not Python, or
    that mean what was there before, are drawn again.
    """
    rng = random.Random(seed)
    sources = {file: (root / file).read_text(encoding="utf-8") for file in files}
    candidates = [place for file in sorted(files) for place in places(file, sources[file])]
    rng.shuffle(candidates)
    mutants: list[Mutant] = []
    for place in candidates:
        if len(mutants) == number:
            break
        for operator, occurrence in rng.sample(place.operators, len(place.operators)):
            mutant = _mutant(place, operator, occurrence, sources[place.file])
            if mutant is not None:
                mutants.append(mutant)
                break
    return mutants


def _named_operators() -> Iterator[tuple[str, str]]:
    """Yield operators with their kind: arithmetic is replaced by arithmetic, since `1.0 | x` fails wherever it runs."""
    for name in _OPERATORS:
        for beginning, kind in _KINDS:
            if name.startswith(beginning) and (
                kind != "arithmetic" or any(set(name.split("_")[1:]) <= family for family in _FAMILIES)
            ):
                yield name, kind


def _mutant(place: Place, operator: str, occurrence: int, source: str) -> Mutant | None:
    """Return the mutant, or None if it is not Python or means the same."""
    try:
        mutated = mutate_code(source, _OPERATORS[operator](), occurrence)
    except AttributeError:  # Cosmic Ray replaces exceptions by plain names only: `struct.error` has a dot
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("error", SyntaxWarning)  # `is "text"`: the same as `==` for a literal
        try:
            if mutated is None or ast.dump(ast.parse(mutated)) == ast.dump(ast.parse(source)):
                return None
            compile(mutated, place.file, "exec")
        except (SyntaxError, SyntaxWarning, ValueError):
            return None
    old, new = source.splitlines(), mutated.splitlines()
    at = place.begin[0] - 1
    return Mutant(place, operator, mutated, old[at].strip(), new[at].strip() if len(new) == len(old) else "")


def _without_effect(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield the parts of a file whose mutants are equivalent, or are not run as Python."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            compiled = any(isinstance(each, ast.Name) and each.id in ("kernel", "njit") for each in node.decorator_list)
            if compiled or all(
                isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant) for each in node.body
            ):
                yield node  # or a member of a protocol, which is never run
            if node.returns is not None:
                yield node.returns
        elif isinstance(node, ast.arg | ast.AnnAssign):
            if node.annotation is not None:
                yield node.annotation
        elif isinstance(node, ast.keyword):
            if node.arg == "strict":
                yield node
        elif isinstance(node, ast.Assign):
            if ast.unparse(node.targets[0]) == "__all__" or _is_alias(node):
                yield node
        elif (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING") or (
            isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[0] in ("logging", "logger")
        ):
            yield node


def _is_alias(node: ast.Assign) -> bool:
    """Whether types get a name: `Said = Callable[[str], None] | None` does so, `_ALL = {*NAMES} | _OTHER` does not."""
    ends, parts = [node.value], []
    while ends:
        each = ends.pop()
        if isinstance(each, ast.BinOp) and isinstance(each.op, ast.BitOr):
            ends += [each.left, each.right]
        else:
            parts.append(each)
    return len(parts) > 1 and all(
        (isinstance(each, ast.Constant) and each.value is None)
        or (isinstance(each, ast.Subscript) and ast.unparse(each.value)[:1].isupper())
        or (isinstance(each, ast.Name) and each.id[:1].isupper() and not each.id.isupper())
        or (isinstance(each, ast.Name) and each.id in ("int", "float", "str", "bytes", "bool"))
        for each in parts
    )


def _span(node: ast.AST, lines: Sequence[str]) -> tuple[_Position, _Position]:
    """Return where a node begins and ends, its columns counted in characters as Cosmic Ray counts them."""

    def characters(line: int, column: int) -> int:
        return len(lines[line - 1].encode()[:column].decode())

    first, last = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.decorator_list:
        first = (node.decorator_list[0].lineno, 0)
    return (first[0], characters(*first)), (last[0], characters(*last))
