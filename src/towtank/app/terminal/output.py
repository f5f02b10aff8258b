"""Where a command speaks: results on standard output, progress and messages on standard error.

Its one JSON document has null for NaN and infinity, lists for arrays, text for paths.
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import PurePath
from typing import Any

from rich.box import ASCII, SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from towtank.printable import printable

__all__ = ["COMPILING", "Output", "Progress", "TextConsole", "json_text", "plain", "watching_compilation"]

Progress = Callable[[str, float], None]
_PATIENCE = 0.7  # s that a person waits without a word
COMPILING = "compiling kernels (first run only, half a minute)"


def plain(value: Any) -> Any:
    """Return `value` as dictionaries, lists, numbers, texts and None.

    >>> plain({"std": float("nan"), "window": (0.0, 1.0)})
    {'std': None, 'window': [0.0, 1.0]}
    """
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy
        return plain(value.tolist())
    if hasattr(value, "model_dump"):
        return plain(value.model_dump())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, int):
        return value
    raise TypeError(f"found {type(value).__name__}, which has no place in a JSON document")


def json_text(document: Mapping[str, Any]) -> str:
    """Return the document as JSON, pure ASCII, indented."""
    return json.dumps(plain(document), indent=2, allow_nan=False)


class TextConsole(Console):
    """A console to which texts are texts: nothing in them is markup, an emoji, or a command of the terminal.

    Steering characters are written out where anything is rendered, so that cells are cut to their columns after it, and
    whatever is shown, live views and bars too, goes through here.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, markup=False, emoji=False, **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of something to show, with steering characters written out."""
        for segment in super().render(renderable, options):
            text, style, control = segment
            yield segment if control else Segment(printable(text), style)


class Output:
    """The two streams of one command. With `json` the tables are not printed, only the document is."""

    def __init__(self, *, json: bool = False) -> None:
        self.json = json
        self.console: Console = TextConsole(soft_wrap=False, quiet=json)
        self.warnings: list[str] = []

    @property
    def ascii(self) -> bool:
        """True where the terminal cannot show more than ASCII."""
        return not self.console.encoding.lower().startswith("utf")

    def document(self, document: Mapping[str, Any]) -> None:
        """Print the JSON document, where it was asked for."""
        if self.json:
            sys.stdout.write(f"{json_text(document)}\n")

    def warn(self, text: str) -> None:
        """Say on standard error what a person had better know."""
        self.warnings.append(text)
        sys.stderr.write(f"towtank: warning: {printable(text)}\n")

    def say(self, text: str) -> None:
        """Say on standard error what is being done."""
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()

    def line(self, text: str = "", style: str = "") -> None:
        """Print one line or paragraph, wrapped at the width of the terminal."""
        self.console.print(Text(text, style=style))

    def verbatim(self, text: str) -> None:
        """Print a text as it is, never wrapped: to be copied."""
        self.console.print(Text(text), soft_wrap=True)

    def heading(self, text: str) -> None:
        """Print an empty line and a heading."""
        self.console.print()
        self.console.print(Text(text, style="bold"))

    def item(self, text: str, style: str = "", mark: str = "-") -> None:
        """Print a paragraph beside a mark."""
        grid = Table.grid(padding=(0, 1))
        grid.add_column(no_wrap=True)
        grid.add_column(overflow="fold")
        grid.add_row(mark, Text(text, style=style))
        self.console.print(grid)

    def table(self, *columns: str, wrap: str = "") -> Table:
        """Return an empty table; a column named with a leading `>` holds numbers; `wrap` is the one that may wrap."""
        table = Table(
            box=ASCII if self.ascii else SIMPLE_HEAD,
            pad_edge=False,
            padding=(0, 1, 0, 0),
            show_edge=False,
            header_style="bold",
        )
        for column in columns:
            name = column.removeprefix(">")
            right = column.startswith(">")
            table.add_column(name, justify="right" if right else "left", no_wrap=name != wrap, overflow="fold")
        return table

    def show(self, table: Table) -> None:
        """Print a table."""
        self.console.print(table)

    def bar(self, share: float, width: int = 20) -> str:
        """Return a bar for a share 0 .. 1."""
        full = round(width * min(max(share, 0.0), 1.0))
        return ("#" if self.ascii else "█") * full

    @contextlib.contextmanager
    def telling_compilation(self) -> Iterator[None]:
        """Say once that kernels are being compiled, if they are, where there is no bar that says so."""
        if sys.stderr.isatty():
            yield
            return
        with watching_compilation(lambda: self.say(COMPILING)):
            yield

    @contextlib.contextmanager
    def progress(self, text: str) -> Iterator[Progress]:
        """Show a bar on standard error while something takes long, where that is a terminal.

        Yields a function to be called with a text and the share done, 0 .. 1.
        """
        if not sys.stderr.isatty():
            yield lambda text, share: None
            return
        console = TextConsole(stderr=True)
        times = (TimeElapsedColumn(), TimeRemainingColumn(compact=True), TextColumn("left"))
        columns = (TextColumn("{task.description}", markup=False), BarColumn(bar_width=20), *times)
        with ProgressBar(*columns, console=console, transient=True) as bar:
            task = bar.add_task(text, total=1.0, visible=False)
            late = threading.Timer(_PATIENCE, lambda: bar.update(task, visible=True))  # in the midst of a step, too
            late.daemon = True
            late.start()

            def show(text: str, share: float) -> None:
                bar.update(task, description=text, completed=share)

            def compiling() -> None:
                bar.update(task, description=COMPILING, visible=True)

            try:
                with watching_compilation(compiling):
                    yield show
            finally:
                late.cancel()


@contextlib.contextmanager
def watching_compilation(begins: Callable[[], None]) -> Iterator[None]:
    """Call `begins` once if Numba compiles a kernel that it has not kept on disk."""
    from numba.core import event

    pending = [begins]

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            if pending:
                pending.pop()()

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        yield
