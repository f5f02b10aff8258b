"""Options that several commands share, and how their texts are read."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from towtank.errors import InputError
from towtank.readers.registry import SUFFIXES

if TYPE_CHECKING:
    from towtank.recording import Recording

__all__ = [
    "LOG_KINDS",
    "Json",
    "KeepAll",
    "Log",
    "LogPlace",
    "Map",
    "Merge",
    "MergeMap",
    "Merged",
    "Report",
    "Window",
    "WindowTexts",
    "command_text",
    "is_number",
    "log_places",
    "numbers",
    "output_place",
    "positive_option",
    "reachable_fit",
    "report_place",
]

LOG_KINDS = ", ".join(SUFFIXES)
_STRETCH = re.compile(r"[-+.\deE ]*,[-+.\deE ]*")
Log = Annotated[Path, typer.Argument(metavar="LOG", help=f"Log file ({LOG_KINDS}) or the folder of a ROS 2 bag.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else on standard output.")]
Map = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="MAPPING",
        help="TOML file that names the column (or TABLE.field) of the log for each channel; inspect --map-skeleton "
        "writes a first draft.",
    ),
]
Merge = Annotated[
    list[str] | None,
    typer.Option(
        "--merge",
        metavar="FILE[@SECONDS]",
        help="A second file of the same run, such as motion capture beside the autopilot's log; may be repeated. The "
        "offset of its clock is found from the motion that both files show. To give it yourself: mocap.csv@+12.3 adds "
        "12.3 s to the file's times.",
    ),
]
MergeMap = Annotated[
    list[Path] | None,
    typer.Option(
        "--merge-map",
        metavar="MAPPING",
        help="Mapping for the files of --merge: one for all of them, or one for each, in the same order.",
    ),
]
WindowTexts = Annotated[
    list[str] | None,
    typer.Option(
        "--window",
        metavar="START,END",
        help="Use only this stretch of time, in seconds of the log's own clock. Either end may be left out (10, or "
        ",60); "
        "a negative number counts from the end. May be repeated. For a single log of several: dive.BIN@12,178@200,260.",
    ),
]
KeepAll = Annotated[
    bool,
    typer.Option(
        "--keep-all",
        help="Use the whole log. Without this option, stretches are left out in which the vehicle is disarmed, at the "
        "surface or out of the water, upside down, in a mode that ignores commands, or without commands.",
    ),
]
Report = Annotated[
    Path | None,
    typer.Option(
        "--report",
        metavar="FILE.html",
        help="Report to write: one page with tables and figures. FILE.pdf needs Chromium, Chrome or Edge.",
    ),
]


@dataclass(frozen=True)
class Window:
    """A stretch of time [s]; None where it is open, negative from the end of the log."""

    start: float | None
    end: float | None

    @classmethod
    def parse(cls, text: str | None, option: str = "--window") -> Window | None:
        """Read `START,END`, which the option or argument gave. Raises InputError."""
        if text is None:
            return None
        parts = text.split(",")
        if len(parts) != 2 or not text.strip(" ,"):
            raise InputError(f'{option}: found "{text}", expected START,END in seconds, as 10,60 or 10,')
        start, end = (_number(option, part) if part.strip() else None for part in parts)
        return cls.of(start, end, f'{option}: found "{text}"')

    @classmethod
    def of(cls, start: float | None, end: float | None, found: str = "") -> Window:
        """Return a window; `found` begins the InputError where its end is not after its start, or one is no number."""
        found = found or f"window: found ({start}, {end})"
        for edge in (start, end):
            if edge is not None and not (is_number(edge) and math.isfinite(edge)):
                raise InputError(f"{found}, expected finite numbers of seconds, None where it is open")
        start, end = (None if edge is None else float(edge) for edge in (start, end))
        if start is not None and end is not None and (start < 0.0) == (end < 0.0) and not end > start:
            raise InputError(f"{found}, expected an end after the start")
        return cls(start, end)

    def within(self, recording: Recording) -> tuple[float, float]:
        """Return the stretch [s] in the clock of a recording; an open end is infinite."""
        start, end = (self._own(edge, recording) for edge in (self.start, self.end))
        return (-math.inf if start is None else start), (math.inf if end is None else end)

    @staticmethod
    def _own(edge: float | None, recording: Recording) -> float | None:
        from_end = edge is not None and edge < 0.0 and recording.start >= 0.0
        return recording.end + edge if from_end and edge is not None else edge


@dataclass(frozen=True)
class LogPlace:
    """A log as it was named: its file, and the windows of it that are wanted, none where all of it is."""

    path: Path
    windows: tuple[Window, ...] = ()

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name


def log_places(logs: Sequence[Path], windows: Sequence[str] | None) -> list[LogPlace]:
    """Return the logs that are named as FILE or FILE@START,END@START,END; with windows of its own a log has no others.

    A file whose own name bears an @ is that file.

    Args:
        windows: texts of --window, for the logs that name none. Raises InputError.
    """
    common = tuple(window for text in windows or () if (window := Window.parse(text)) is not None)
    return [_log_place(log, common) for log in logs]


def _log_place(log: Path, common: tuple[Window, ...]) -> LogPlace:
    whole, texts = str(log), list[str]()
    while "@" in whole and not Path(whole).exists():
        whole, _, text = whole.rpartition("@")
        texts.insert(0, text)
    if not Path(whole).exists() and not all(_STRETCH.fullmatch(text) for text in texts):
        return LogPlace(log, common)  # a name with an @, of a file that is missing
    own = [Window.parse(text, f"{log}: after the @") for text in texts]
    return LogPlace(Path(whole), tuple(each for each in own if each is not None) or common)


@dataclass(frozen=True)
class Merged:
    """A second file of a run: its place, the offset of its clock [s] (None: found), and its mapping."""

    path: Path
    offset: float | None = None
    mapping: Path | None = None

    @classmethod
    def parse(
        cls, texts: Sequence[str] | None, mappings: Sequence[Path] | None, logs: Sequence[Path]
    ) -> tuple[Merged, ...]:
        """Read the files of --merge with their mappings. Raises InputError."""
        texts, mappings = list(texts or ()), list(mappings or ())
        if mappings and not texts:
            raise InputError(f"--merge-map {mappings[0]}: there is no --merge FILE that it could be of")
        if len(mappings) > 1 and len(mappings) != len(texts):
            raise InputError(
                f"--merge-map: found {len(mappings)} mappings for {len(texts)} files of --merge, expected one for all "
                "or one for each"
            )
        if texts and len(logs) > 1:
            raise InputError(
                f"--merge {texts[0]}: found {len(logs)} logs, expected one; make one file of each run first: "
                f"towtank convert {logs[0]} RUN.parquet --merge {texts[0]}"
            )
        each = mappings if len(mappings) > 1 else mappings * len(texts)
        return tuple(cls._of(text, each[k] if each else None) for k, text in enumerate(texts))

    @classmethod
    def _of(cls, text: str, mapping: Path | None) -> Merged:
        name, at, offset = text.rpartition("@")
        if not at or Path(text).exists():
            return cls(Path(text), None, mapping)
        if not name:
            raise InputError(f'--merge: found "{text}", expected FILE or FILE@SECONDS, as mocap.csv@+12.3')
        return cls(Path(name), _number(f"--merge {name}@", offset), mapping)


def numbers(option: str, text: str | None, count: int, expected: str) -> tuple[float, ...] | None:
    """Read `count` numbers with commas between. Raises InputError."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != count:
        raise InputError(f'{option}: found "{text}", expected {expected}')
    return tuple(_number(option, part) for part in parts)


def _number(option: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f'{option}: found "{text.strip()}", expected a number') from None
    if not math.isfinite(value):
        raise InputError(f'{option}: found "{text.strip()}", expected a finite number')
    return value


def is_number(value: object) -> bool:
    """Whether a value is a real number, NumPy's own included; truth values are none."""
    return isinstance(value, Real) and not isinstance(value, bool)


def positive_option(option: str, value: float | None, *, zero: bool = False) -> float | None:
    """Return the value of an option. Raises InputError unless it is a finite number above 0 (or 0)."""
    if value is not None and not (
        is_number(value) and math.isfinite(value) and (value > 0.0 or (zero and value == 0.0))
    ):
        found = f"{value:g}" if is_number(value) else repr(value)
        raise InputError(f"{option}: found {found}, expected a number {'of 0 or more' if zero else 'above 0'}")
    return value


def reachable_fit(option: str, value: float | None) -> float | None:
    """Return a fit [%] that is required. Raises InputError unless it is a number of at most 100."""
    if value is not None and not (is_number(value) and value <= 100.0):
        found = f"{value:g}" if is_number(value) else repr(value)
        raise InputError(f"{option}: found {found}, expected a fit in percent, 100 at most")
    return value


def output_place(option: str, path: Path | None, suffixes: tuple[str, ...]) -> Path | None:
    """Return the place of an output. Raises InputError, before any work is done, if it cannot be written there."""
    if path is None:
        return None
    if path.suffix.lower() not in suffixes:
        raise InputError(f'{option}: found "{path}", expected a name that ends in {" or ".join(suffixes)}')
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first or choose another place")
    if path.is_dir():
        raise InputError(f"{path}: this is a folder, expected the name of a file to write")
    return path


def report_place(path: Path | None) -> Path | None:
    """Return the place of a report. Raises InputError, before any work is done, if none can be written there."""
    if (
        output_place("--report", path, (".html", ".pdf")) is not None
        and path is not None
        and path.suffix.lower() == ".pdf"
    ):
        from towtank.report.browser import find_browser

        if find_browser() is None:
            raise InputError(
                f"--report {path}: no browser to print a PDF with was found; install Chromium, Chrome or Edge, or ask "
                "for .html and print it from any browser"
            )
    return path


def command_text(command: str, words: Sequence[object], options: Mapping[str, Any]) -> str:
    """Return a command as it is typed; options that are None or False are left out.

    >>> command_text("learn", ["a b.csv"], {"--vehicle": "seamor", "--delay": None, "--current": True})
    "towtank learn 'a b.csv' --vehicle seamor --current"
    """
    parts = ["towtank", command, *map(str, words)]
    for name, value in options.items():
        if value is True:
            parts.append(name)
        elif value is not None and value is not False:
            for each in value if isinstance(value, list | tuple) else [value]:
                parts += [name, str(each)]
    return shlex.join(parts)
