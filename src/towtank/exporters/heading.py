"""The comment that opens every exported file: where the model comes from, every coefficient, and what is missing.

It is plain ASCII and holds nothing that could end a comment in XML, C, Python, MATLAB or YAML. What it says can be read
back (`heading_of`), so that a model that was imported says the same when it is exported again.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.exporters.request import Kept, Request, differing, speed_range
from towtank.vehicle import COEFFICIENTS, Vehicle, index, unit
from towtank.vehicle.names import ROWS

__all__ = ["ORIGIN", "Heading", "at_least", "heading_of", "heading_of_request"]

ORIGIN = "exported by towtank from "  # begins the provenance of what was imported from such a file
_LOST = "missing in the file that it was imported from: "
_SOURCE = re.compile(r"^source: (.*), sha256 ([0-9a-f]{64})$")
_COEFFICIENT = re.compile(r"^  (\w+) = (\S+)(?: \+- (\S+))?(?: .*)?$")
_ESCAPE = re.compile(r"\\x([0-9a-f]{2})|\\u([0-9a-f]{4})|\\U([0-9a-f]{8})")
_MARKS = ("--", "*/", "/*", "%{", "%}", "?>", '"""', "'''", "??")  # begin or end a comment, or are trigraphs
_ROUNDING = 1e-9  # of the wrench at full speed: what is below it is said to be exact


@dataclass(frozen=True)
class Heading:
    """What opens an exported file.

    Attributes:
        title: target and version. vehicle: its name. source, sha256: of the model's file.
        coefficients: a line each. missing: what the target cannot say, a line each. error: the line on the wrench.
    """

    title: str
    vehicle: str
    source: str
    sha256: str
    coefficients: tuple[str, ...]
    missing: tuple[str, ...]
    error: str

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines of the comment, without the signs of a comment."""
        head = (
            f"towtank: {self.title}",
            f"vehicle: {self.vehicle}",
            f"source: {self.source}, sha256 {self.sha256}",
            "coefficients (SNAME, body FRD, SI; value +- standard deviation where one is stated):",
            *(f"  {each}" for each in self.coefficients),
        )
        lost = ("missing: nothing",) if not self.missing else ("missing:", *(f"  {each}" for each in self.missing))
        return tuple(_harmless(each) for each in (*head, *lost, self.error))

    def commented(self, prefix: str = "# ") -> str:
        """The comment with a prefix before every line, as `# ` or `% `."""
        return "".join(f"{prefix}{line}".rstrip() + "\n" for line in self.lines)

    @property
    def xml(self) -> str:
        """The comment of an XML file."""
        return "<!--\n" + "".join(f"  {line}\n" for line in self.lines) + "-->\n"

    @property
    def origin(self) -> str:
        """What the provenance of an imported vehicle says, and `heading_of_request` understands."""
        return f"{ORIGIN}{self.source}, sha256 {self.sha256}"

    @property
    def notes(self) -> tuple[str, ...]:
        """What the notes of an imported vehicle say of what was lost before."""
        return tuple(_LOST + each for each in (*self.missing, self.error))

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviations by the coefficients' names, where they are stated."""
        found = {}
        for line in self.coefficients:
            match = _COEFFICIENT.match(f"  {line}")
            if match is not None and match[3] is not None:
                found[match[1]] = float(match[3])
        return found


def heading_of_request(title: str, request: Request, kept: Kept, away: Array) -> Heading:
    """Return the opening of an export; what a vehicle lost on an earlier way stays said.

    `away` is the largest error of the wrench (6,) [N, N m].
    """
    vehicle = request.vehicle
    source, sha256 = request.source, request.sha256
    before = _earlier(vehicle)
    if before is not None:
        source, sha256 = before
    missing = [*kept.remarks, *differing(vehicle, kept.vehicle)]
    error = _error_line(vehicle, away)
    earlier = [note.removeprefix(_LOST) for note in vehicle.provenance.notes if note.startswith(_LOST)]
    if earlier:
        missing = [*earlier[:-1], *(each for each in missing if each not in earlier)]
        error = earlier[-1] if missing == earlier[:-1] else error
    coefficients = tuple(_coefficients(vehicle, kept.vehicle))
    return Heading(title, _harmless(vehicle.name), source, sha256, coefficients, tuple(missing), error)


def heading_of(text: str) -> Heading | None:
    """Return the opening of a file that towtank exported, out of its comment; None where it has none."""
    lines = [line.strip("\r\n") for line in text.splitlines()]
    start = next((k for k, line in enumerate(lines) if "towtank: " in line), None)
    if start is None:
        return None
    prefix = lines[start].index("towtank: ")
    body = [line[prefix:] for line in lines[start:]]
    source = _SOURCE.match(body[2]) if len(body) > 3 else None
    if source is None or not body[1].startswith("vehicle: "):
        return None
    coefficients, k = [], 4
    while k < len(body) and _COEFFICIENT.match(body[k]):
        coefficients.append(body[k].strip())
        k += 1
    missing = []
    if k < len(body) and body[k] == "missing:":
        while k + 1 < len(body) and body[k + 1].startswith("  "):
            k += 1
            missing.append(body[k].strip())
    error = body[k + 1] if k + 1 < len(body) else ""
    title, name = body[0].removeprefix("towtank: "), _ESCAPE.sub(_letter, body[1].removeprefix("vehicle: "))
    return Heading(title, name, source[1], source[2], tuple(coefficients), tuple(missing), error)


def _letter(escape: re.Match[str]) -> str:
    """Return the letter beyond ASCII that an escape stands for; the escape itself where it is another one."""
    code = int(escape[1] or escape[2] or escape[3], 16)
    letter = chr(code) if 0x7F < code < 0x110000 else ""
    return letter if letter.isprintable() and letter else escape[0]


def _earlier(vehicle: Vehicle) -> tuple[str, str] | None:
    """Return source and hash of the model that a vehicle was imported from, where an export by towtank said them."""
    if not vehicle.provenance.source.startswith(ORIGIN):
        return None
    match = _SOURCE.match("source: " + vehicle.provenance.source.removeprefix(ORIGIN))
    return None if match is None else (match[1], match[2])


def _coefficients(vehicle: Vehicle, kept: Vehicle) -> Iterable[str]:
    """Return a line for every coefficient that a target keeps, with the deviation where it keeps the very value."""
    for name in COEFFICIENTS:
        kind, i, j = index(name)
        if kind == "mass" and i > j:
            continue  # the mirrored name stands above
        value = kept.coefficient(name)
        std = vehicle.deviation(name) if math.isclose(value, vehicle.coefficient(name), rel_tol=1e-9) else None
        if value != 0.0 or std is not None:
            text = f"{value:.12g}" if kind in ("weight", "moment") else repr(value)  # those are computed
            yield f"{name} = {text}{'' if std is None else f' +- {std!r}'} {unit(name)}"


def _error_line(vehicle: Vehicle, error: Array) -> str:
    speeds = speed_range(vehicle)
    linear, angular = (", ".join(short(each, 2) for each in part) for part in (speeds[:3], speeds[3:]))
    reach = f"up to {linear} m/s and {angular} rad/s"
    scale = _ROUNDING * (vehicle.weight + float(np.abs(vehicle.mass_matrix @ speeds).max()))
    if error.max() <= scale:
        return f"largest error of the wrench, {reach}: none"
    each = ", ".join(f"{ROWS[i]} {at_least(error[i], 3)}" for i in range(6))
    return f"largest error of the wrench, {reach}: {each} (N, N m)"


def at_least(value: float, digits: int) -> str:
    """Return a number above 0 with so many digits, rounded up: what is stated is never exceeded."""
    step = 10.0 ** (math.floor(math.log10(value)) - digits + 1) if value > 0.0 else 1.0
    return short(math.ceil(value / step * (1.0 - 1e-12)) * step, digits)


def _harmless(line: str) -> str:
    """Return a line of printable ASCII in which no comment ends."""
    plain = "".join(each if each.isprintable() else " " for each in line).encode("ascii", "backslashreplace").decode()
    for mark in _MARKS:
        while mark in plain:
            plain = plain.replace(mark, f"{mark[0]} {mark[1:]}")
    return plain
