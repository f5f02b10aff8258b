"""From what went wrong to one line on standard error and an exit code: 0 done, 1 a fault, 2 wrong input, 130 Ctrl-C.

No traceback is ever shown unless the environment says TOWTANK_TRACEBACK=1.
"""

from __future__ import annotations

import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from towtank.errors import InputError, nearest
from towtank.printable import printable

__all__ = [
    "FAULT",
    "INTERRUPTED",
    "ORDER",
    "WRONG_INPUT",
    "Commands",
    "PlainCommand",
    "drop_output",
    "guarded",
    "line_of",
    "wants_traceback",
]

FAULT, WRONG_INPUT, INTERRUPTED = 1, 2, 130
ORDER = (
    *("demo", "vehicle", "manoeuvre", "plan", "simulate", "inspect", "learn", "live", "validate", "campaign"),
    *("config", "convert", "export", "import"),
)


class PlainCommand(TyperCommand):
    """A command whose usage line names its arguments without braces."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the pieces of the usage line."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]

    def get_help(self, ctx: Any) -> str:
        """Return the help text, the arguments without the names of Python types."""
        for parameter in self.params:
            if parameter.param_type_name == "argument":
                parameter.display_type_rich = lambda *_, **__: ""  # type: ignore[attr-defined]
        return super().get_help(ctx)


class Commands(TyperGroup):
    """The command `towtank`: whoever runs it, shell or test, gets exit codes and one-line errors."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the commands in the order in which a newcomer meets them."""
        names = super().list_commands(ctx)
        return [name for name in ORDER if name in names] + [name for name in names if name not in ORDER]

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command line `args` (default: the process's own) and exit."""
        run = super().main
        words = list(sys.argv[1:] if args is None else args) or ["--help"]

        def once() -> Any:
            return run(words, "towtank", complete_var, False, windows_expand_args, **extra)

        if not standalone_mode:
            return once()
        sys.exit(guarded(once))


def guarded(run: Callable[[], Any]) -> int:
    """Return the exit code of `run`; what it raises becomes one line on standard error."""
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warning_line
            code = run()
        sys.stdout.flush()
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except BrokenPipeError:
        drop_output()
        return FAULT
    except Exception as error:
        return _report(*line_of(error))
    return code if isinstance(code, int) else 0


def line_of(error: Exception) -> tuple[str, int]:
    """Return the line that says what went wrong, and the exit code of that."""
    if isinstance(error, InputError):
        return f"towtank: {error}", WRONG_INPUT
    if hasattr(error, "format_message"):
        return _usage_line(error), WRONG_INPUT
    return _fault_line(error), FAULT


def wants_traceback() -> bool:
    """True where the environment asks for tracebacks."""
    return os.environ.get("TOWTANK_TRACEBACK", "") not in ("", "0")


def _report(line: str, code: int) -> int:
    if wants_traceback():
        traceback.print_exc()
    sys.stderr.write(f"{printable(line)}\n")
    return code


def _fault_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"towtank: {error.filename}: {error.strerror}"
    what = " ".join(str(error).split())
    kind = "out of memory" if isinstance(error, MemoryError) else type(error).__name__
    reason = f"{kind}: {what}" if what else kind
    return f"towtank: {reason} (set TOWTANK_TRACEBACK=1 to see where)"


def _usage_line(error: Any) -> str:
    """Return one line for an error in the arguments: the command, what is wrong, what may have been meant."""
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "towtank"
    text = " ".join(error.format_message().split()).rstrip(".")
    unknown = re.match(r"(?i)no such (option|command):? '?([^\s']+)'?", text)
    if unknown and context is not None:
        text = f"no such {unknown[1].lower()} {unknown[2]}{_meant(unknown[1].lower(), unknown[2], context)}"
    if text == "Missing command" and context is not None:
        text += f"; there are {', '.join(context.command.list_commands(context))}"
    text = re.sub(r"Input should be (a valid )?([^,]*).*", r"expected a \2", text).replace("Value error, ", "")
    text = text.replace("a integer", "a whole number")
    text = text[:1].lower() + text[1:]
    return f"{command}: {text} (see {command} --help)"


def _meant(kind: str, word: str, context: Any) -> str:
    if kind == "command":
        known = list(context.command.list_commands(context))
        return nearest(word, known) or f"; there are {', '.join(known)}"
    known = [name for parameter in context.command.get_params(context) for name in getattr(parameter, "opts", ())]
    return nearest(word, [name for name in known if name.startswith("-")])


def _warning_line(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    """Say a warning of our own; those of libraries, of numbers that overflow above all, are no words for a person."""
    if issubclass(category, UserWarning) and category.__module__.startswith("towtank"):
        sys.stderr.write(f"towtank: warning: {printable(' '.join(str(message).split()))}\n")


def drop_output() -> None:
    """Send what is still to be flushed nowhere, so that the interpreter ends in silence."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
    except (OSError, ValueError):
        return
