"""A xacro expanded without ROS: properties, arguments at their defaults, macros, conditions, and files beside it.

What is not understood is named, and what could not be found is left out and named. `$(find package)` is looked for in
the folders above the file: in one of that name, and in one beside those. Expressions are arithmetic: nothing of Python
can be reached from them. Source: wiki.ros.org/xacro and xacro's own __init__.py.
"""

from __future__ import annotations

import ast
import copy
import math
import operator
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from towtank.errors import InputError
from towtank.exporters.importing.guarded import read_xml

__all__ = ["expanded", "is_xacro"]

_NAMESPACE = re.compile(r"\{[^}]*xacro[^}]*\}(.+)")
_PART = re.compile(r"\$\$[{(]|\$\{([^}]*)\}|\$\(([^)]*)\)")
_PARAMETER = re.compile(r"""([*]{0,2}\w+)(?::?=(?:\^\|?)?('[^']*'|"[^"]*"|\S*))?""")
_MOST, _DEEPEST, _FILES = 30_000, 40, 50  # elements written, macros within macros, files included
_LONGEST, _LARGEST = 10_000, 1e100  # characters of a text, size of a number
_CURE = "expand it with ROS (xacro model.xacro > model.urdf) and import that"

Value = float | int | bool | str
_BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: lambda a, b: math.pow(a, b),
}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Value, Value], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_FUNCTIONS: dict[str, Callable[..., float]] = {
    **{name: getattr(math, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sqrt", "radians")},
    **{"degrees": math.degrees, "abs": abs, "min": min, "max": max, "float": float, "int": int, "pow": math.pow},
}
_CONSTANTS: dict[str, Value] = {"pi": math.pi, "e": math.e, "True": True, "False": False, "true": True, "false": False}


class _Macro(NamedTuple):
    parameters: tuple[tuple[str, str | None], ...]
    body: Element


class _Scope(NamedTuple):
    """What names stand for: values, blocks of elements, and where else to look."""

    values: dict[str, str]
    blocks: dict[str, list[Element]]
    outer: _Scope | None

    def find(self, name: str) -> str | None:
        """Return the text of a property; None where there is none."""
        scope: _Scope | None = self
        while scope is not None:
            if name in scope.values:
                return scope.values[name]
            scope = scope.outer
        return None

    def block(self, name: str) -> list[Element] | None:
        """Return the elements of a block; None where there is none."""
        scope: _Scope | None = self
        while scope is not None:
            if name in scope.blocks:
                return scope.blocks[name]
            scope = scope.outer
        return None


def is_xacro(root: Element) -> bool:
    """Return whether a file has elements of xacro."""
    return any(_NAMESPACE.match(str(each.tag)) for each in root.iter())


def expanded(root: Element, path: Path) -> tuple[Element, tuple[str, ...]]:
    """Return a xacro's XML, and what is left of it: files and macros that were not found.

    Raises:
        InputError: an expression or element that is not understood, with what to run instead; too large.
    """
    reading = _Expansion(path)
    scope = _Scope({}, {}, None)
    found = Element(root.tag)
    try:
        reading.below(root, found, scope, path, 0)
        found.attrib.update({name: reading.text(value, scope) for name, value in root.attrib.items()})
    except RecursionError:
        raise InputError(f"{path}: found too many macros and elements within each other; {_CURE}") from None
    return found, tuple(dict.fromkeys(reading.left))


class _Expansion:
    """A xacro being expanded."""

    def __init__(self, path: Path) -> None:
        self.path, self.left, self.count, self.files = path, list[str](), 0, 0
        self.macros: dict[str, _Macro] = {}
        self.arguments: dict[str, str] = {}

    def below(self, source: Element, target: Element, scope: _Scope, file: Path, depth: int) -> None:
        """Expand the elements below `source` into `target`."""
        self._append_text(target, source.text, scope)
        for each in source:
            self.element(each, target, scope, file, depth)
            self._append_text(target, each.tail, scope)

    def element(self, each: Element, target: Element, scope: _Scope, file: Path, depth: int) -> None:
        """Expand one element into `target`."""
        self.count += 1
        if self.count > _MOST or depth > _DEEPEST:
            raise InputError(f"{self.path}: found more than {_MOST} elements or {_DEEPEST} macros within each other")
        match = _NAMESPACE.match(str(each.tag))
        if match is None:
            found = Element(each.tag, {name: self.text(value, scope) for name, value in each.attrib.items()})
            target.append(found)
            self.below(each, found, scope, file, depth)
            return
        kind = match[1]
        if kind == "property":
            self._property(each, scope)
        elif kind == "arg":
            self.arguments.setdefault(each.get("name", ""), self.text(each.get("default", ""), scope))
        elif kind == "macro":
            self.macros[each.get("name", "").removeprefix("xacro:")] = _macro(each)
        elif kind in ("if", "unless"):
            if self._is_true(each.get("value", ""), scope) == (kind == "if"):
                self.below(each, target, scope, file, depth + 1)
        elif kind == "insert_block":
            name = self.text(each.get("name", ""), scope)
            block = scope.block(name)
            if block is None:
                raise InputError(f'{self.path}: insert_block: found "{name[:40]}", which no macro was given; {_CURE}')
            for one in block:
                target.append(copy.deepcopy(one))
                self.count += sum(1 for _ in one.iter())
        elif kind == "include":
            self._include(self.text(each.get("filename", ""), scope), target, scope, file, depth)
        elif kind in self.macros:
            self._call(self.macros[kind], each, target, scope, file, depth)
        elif kind in ("element", "attribute", "call"):
            raise InputError(f"{self.path}: xacro:{kind} is not understood here; {_CURE}")
        else:
            self.left.append(f"xacro:{kind[:60]}: no such macro in the files that were found")

    def _append_text(self, target: Element, text: str | None, scope: _Scope) -> None:
        if not text:
            return
        text = self.text(text, scope)
        if len(target):
            target[-1].tail = (target[-1].tail or "") + text
        else:
            target.text = (target.text or "") + text

    def _property(self, each: Element, scope: _Scope) -> None:
        name = each.get("name", "")
        value = each.get("value", each.get("default") if scope.find(name) is None else scope.find(name))
        if value is None:
            scope.blocks[name] = list(each)
            return
        if scope.find(name) is not None:  # its new value may be made of its old one
            value = self.text(value, scope)
        kept = scope
        while each.get("scope") in ("parent", "global") and kept.outer is not None:
            kept = kept.outer
            if each.get("scope") == "parent":
                break
        kept.values[name] = value if kept is scope else self.text(value, scope)

    def _call(self, macro: _Macro, each: Element, target: Element, scope: _Scope, file: Path, depth: int) -> None:
        inside, children = _Scope({}, {}, scope), [copy.deepcopy(one) for one in each]
        for name, default in macro.parameters:
            if name.startswith("*"):
                if not children:
                    raise InputError(f"{self.path}: a macro wants a block {name}, found none; {_CURE}")
                box = Element("box")
                self.element(children.pop(0), box, scope, file, depth + 1)
                inside.blocks[name.lstrip("*")] = (
                    [one for b in box for one in b] if name.startswith("**") else list(box)
                )
                continue
            given = each.get(name, default)
            if given is None:
                raise InputError(f"{self.path}: a macro wants {name[:40]}, found no such attribute; {_CURE}")
            inside.values[name] = self.text(given, scope)
        self.below(macro.body, target, inside, file, depth + 1)

    def _include(self, name: str, target: Element, scope: _Scope, file: Path, depth: int) -> None:
        found = _beside(name, file)
        self.files += 1
        if found is None or self.files > _FILES:
            self.left.append(f"xacro:include {name[:100]}: no such file beside {self.path.name}")
            return
        self.below(read_xml(found)[0], target, scope, found, depth + 1)

    def _is_true(self, text: str, scope: _Scope) -> bool:
        value = _typed(self.text(text, scope))
        if isinstance(value, str):
            raise InputError(f'{self.path}: found the condition "{value[:40]}", expected true, false or a number')
        return bool(value)

    def text(self, text: str, scope: _Scope, seen: tuple[str, ...] = ()) -> str:
        """Return a text with its expressions evaluated."""

        def part(match: re.Match[str]) -> str:
            if match[1] is not None:
                return _text_of(self._value(match[1], scope, seen))
            if match[2] is None:
                return match[0][1:]
            command, _, argument = match[2].strip().partition(" ")
            if command == "arg" and argument.strip() in self.arguments:
                return self.arguments[argument.strip()]
            if command == "find":
                return match[0]
            raise InputError(f'{self.path}: found "{match[0][:60]}", expected an argument with a default; {_CURE}')

        out = _PART.sub(part, text)
        if len(out) > _LONGEST + len(text):
            raise InputError(f"{self.path}: found a text of {len(out)} characters; {_CURE}")
        return out

    def _value(self, expression: str, scope: _Scope, seen: tuple[str, ...]) -> Value:
        def name_of(name: str) -> Value:
            text = scope.find(name)
            if text is not None and name not in seen and len(seen) < _DEEPEST:
                return _typed(self.text(text, scope, (*seen, name)))
            if name in _CONSTANTS:
                return _CONSTANTS[name]
            raise LookupError(f"no property {name[:40]}" if text is None else f"{name[:40]} stands for itself")

        self.count += 1
        if self.count > _MOST or len(expression) > _LONGEST:
            raise InputError(f"{self.path}: found more than {_MOST} expressions, or one too long; {_CURE}")
        try:
            return _evaluated(ast.parse(expression.strip(), mode="eval").body, name_of)
        except (SyntaxError, LookupError, ArithmeticError, TypeError, ValueError, RecursionError, MemoryError) as error:
            if isinstance(error, InputError):
                raise
            reason = error.args[0] if isinstance(error, LookupError) and error.args else "not arithmetic"
            raise InputError(f'{self.path}: found "${{{expression[:60]}}}": {reason}; {_CURE}') from None


def _macro(each: Element) -> _Macro:
    parameters = tuple(
        (match[1], None if match[2] is None else match[2].strip("'\""))
        for match in _PARAMETER.finditer(each.get("params", ""))
    )
    return _Macro(parameters, each)


def _beside(name: str, file: Path) -> Path | None:
    """Return the file that an include names: relative to its own, or in a package among the folders above it."""
    match = re.match(r"\$\(find ([\w.-]+)\)/*(.*)", name)
    if match is None:
        candidates: Iterable[Path] = [file.parent / name]
    else:
        above = file.resolve().parents
        candidates = [each / match[2] for each in above if each.name == match[1]]
        candidates = [*candidates, *(each / match[1] / match[2] for each in above)]
    return next((each for each in candidates if each.is_file()), None)


def _typed(text: str) -> Value:
    plain = text.strip()
    if plain.lower() in ("true", "false"):
        return plain.lower() == "true"
    for kind in (int, float):
        try:
            return kind(plain)
        except ValueError:
            pass
    return text


def _text_of(value: Value) -> str:
    return value if isinstance(value, str) else repr(value)


def _number(value: Value) -> float:
    if isinstance(value, str):
        raise TypeError("a text")
    if abs(value) > _LARGEST:
        raise OverflowError("too large")
    return value


def _evaluated(node: ast.expr, name_of: Callable[[str], Value]) -> Value:
    """Return the value of an expression of numbers, texts and names."""

    def of(inner: ast.expr) -> Value:
        return _evaluated(inner, name_of)

    match node:
        case ast.Constant(value=bool() | int() | float() | str()):
            return node.value  # type: ignore[return-value]
        case ast.Name():
            return name_of(node.id)
        case ast.UnaryOp(op=ast.USub()):
            return -_number(of(node.operand))
        case ast.UnaryOp(op=ast.UAdd()):
            return _number(of(node.operand))
        case ast.UnaryOp(op=ast.Not()):
            return not of(node.operand)
        case ast.BinOp(op=ast.Add()):
            left, right = of(node.left), of(node.right)
            if isinstance(left, str) and isinstance(right, str) and len(left) + len(right) <= _LONGEST:
                return left + right
            return _number(left) + _number(right)
        case ast.BinOp() if type(node.op) in _BINARY:
            return _BINARY[type(node.op)](_number(of(node.left)), _number(of(node.right)))
        case ast.Compare(ops=[op], comparators=[right_node]) if type(op) in _COMPARISONS:
            return _COMPARISONS[type(op)](of(node.left), of(right_node))
        case ast.BoolOp():
            values = [bool(of(each)) for each in node.values]
            return all(values) if isinstance(node.op, ast.And) else any(values)
        case ast.IfExp():
            return of(node.body) if of(node.test) else of(node.orelse)
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(value=ast.Name(id="math"), attr=name), keywords=[]):
            if name in _FUNCTIONS:
                return _FUNCTIONS[name](*(_number(of(each)) for each in node.args))
        case ast.Attribute(value=ast.Name(id="math"), attr="pi"):
            return math.pi
    raise TypeError("not arithmetic")
