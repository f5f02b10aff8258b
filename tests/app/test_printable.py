"""Texts of others as they may be shown: on consoles, in bars, in HTML and in TOML."""

from __future__ import annotations

import io
import tomllib

from rich.console import Group
from rich.table import Table
from rich.text import Text

from towtank.app.terminal.output import Output, TextConsole
from towtank.printable import escaped, printable, toml_escaped
from towtank.vehicle import load_vehicle, parse_vehicle, vehicle_text

STEERING = "a\x1b[31m\x07\r\x9b\u202eb\u2066\u200b\ud800\U000e0041"
WRITTEN = r"a\x1b[31m\x07\x0d\x9b\u202eb\u2066\u200b\ud800\U000e0041"


def shown(*things: object, width: int = 100) -> str:
    console = TextConsole(file=io.StringIO(), width=width, force_terminal=True, color_system=None, legacy_windows=False)
    for each in things:
        console.print(each)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_steering_characters_are_written_out_and_nothing_else_is() -> None:
    assert printable(STEERING) == WRITTEN
    assert printable(WRITTEN) == WRITTEN
    plain = "tiefe_wasser \u6c34 \u0baf\u0bcd \u00b1 \u2212 \u00b2 \u202f\ttab\nline \u05d0\u05d1"
    assert printable(plain) == plain


def test_whatever_a_console_renders_holds_no_steering_character() -> None:
    table = Table(STEERING)
    table.add_row(STEERING, Text(STEERING))
    text = shown(STEERING, Text(STEERING), Group(Text(STEERING)), table, "[bold]x[/] :warning:")
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert text.count(r"a\x1b[31m") >= 3
    assert "[bold]x[/] :warning:" in text


def test_cells_are_cut_to_their_columns_after_writing_out() -> None:
    table = Table()
    table.add_column("name", width=12, no_wrap=True, overflow="ellipsis")
    table.add_row("\x1b" * 40)
    assert max(len(line) for line in shown(table).splitlines()) <= 16


def test_what_is_said_and_warned_of_is_written_out(capsys) -> None:
    output = Output()
    output.say(f"page: {STEERING}")
    output.warn(STEERING)
    said = capsys.readouterr().err
    assert said == f"page: {WRITTEN}\ntowtank: warning: {WRITTEN}\n"


def test_html_has_texts_as_texts() -> None:
    assert escaped("<a b='c\" d'>&\x1b") == "&lt;a b=&#x27;c&quot; d&#x27;&gt;&amp;\\x1b"


def test_toml_has_steering_characters_as_its_own_escapes_and_reads_the_same() -> None:
    named = load_vehicle("seamor").model_copy(update={"name": STEERING.replace("\ud800", "")})
    text = vehicle_text(named)
    assert printable(text) == text
    assert text.isprintable() or not set("\x1b\x9b\u202e\u2066") & set(text)
    assert parse_vehicle(text, "here").name == named.name
    assert tomllib.loads(toml_escaped('x = "\ud800"')) == {"x": r"\ud800"}
