"""A process of its own, with one thread, that performs jobs one after the other; its death is an answer, no disaster.

Readers of foreign formats and compiled kernels may take their process with them, and the system ends one that wants too
much memory. So whatever is performed for a campaign is performed in a child.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

__all__ = ["Answer", "Child", "Died"]

_ONE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "ARROW_NUM_THREADS")
_PATIENCE = 5.0  # s, for a process that has closed its end to be gone
_READY = b"ready"
_starting = threading.Lock()  # the environment is the whole process's


class Died(Exception):
    """The process ended before it had answered; the text says how, as `killed by SIGABRT`."""


@dataclass(frozen=True)
class Answer:
    """What came of a job.

    Attributes:
        number: of the job. value: what the work returned. error: what it raised, None where nothing.
        died: how the process ended that performed it, None where it lives; then there is neither value nor error.
    """

    number: int
    value: Any = None
    error: BaseException | None = None
    died: str | None = None


class Child:
    """One process for one kind of work, started with its first job, and anew after its death.

    Args:
        work: a function that another process can import.
    """

    def __init__(self, work: Callable[..., Any]) -> None:
        self._work = work
        self._process: multiprocessing.process.BaseProcess | None = None
        self._ours: Connection | None = None
        self._ended = False

    def answer(self, number: int, job: tuple[Any, ...]) -> Answer:
        """Perform a job; what it raises, or that the process dies, is in the answer."""
        try:
            return Answer(number, value=self.perform(job))
        except Died as death:
            return Answer(number, died=str(death))
        except Exception as error:
            return Answer(number, error=error)

    def perform(self, job: tuple[Any, ...]) -> Any:
        """Return what the work makes of the arguments of a job, or raise what it raises.

        Raises:
            Died: the process ended meanwhile.
            RuntimeError: no process can be started at all.
        """
        ours = self._ours if self._ours is not None and self._lives() else self._start()
        try:
            ours.send(job)
            succeeded, value = ours.recv()
        except (EOFError, ConnectionError, BrokenPipeError) as error:
            raise Died(self._end()) from error
        if succeeded:
            return value
        raise value

    def close(self) -> None:
        """End the process at once, whatever it does."""
        process = self._process
        if process is not None:
            process.kill()
            process.join()

    def end(self) -> None:
        """End the process for good: a job that another thread has just taken starts none either."""
        with _starting:
            self._ended = True
        self.close()

    def _lives(self) -> bool:
        if self._process is not None and self._process.is_alive():
            return True
        self._end()
        return False

    def _start(self) -> Connection:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        with _starting, _single_threaded(), _allowed_children():
            if self._ended:
                raise Died("ended on demand")
            process = context.Process(target=_serve, args=(theirs, self._work), daemon=True)
            process.start()
            self._process, self._ours = process, ours
        theirs.close()
        try:
            ours.recv_bytes()
        except (EOFError, ConnectionError) as error:
            raise RuntimeError(f"a process for the work does not start: {self._end()}") from error
        return ours

    def _end(self) -> str:
        """Forget the process, which has ended or will; return how."""
        process, self._process = self._process, None
        if self._ours is not None:
            self._ours.close()
            self._ours = None
        if process is None:
            return "gone"
        process.join(_PATIENCE)
        if process.exitcode is None:
            process.kill()
            process.join()
        return _how(process.exitcode)


def _how(code: int | None) -> str:
    """Return how a process ended in words."""
    if code is None or code >= 0:
        return f"ended with code {code}"
    with contextlib.suppress(ValueError):
        return f"killed by {signal.Signals(-code).name}"
    return f"killed by signal {-code}"


def _serve(theirs: Connection, work: Callable[..., Any]) -> None:
    """Answer jobs until there are none; what cannot be sent is said."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever asked for the jobs ends them
    threading.Thread(target=_end_with_parent, daemon=True).start()
    theirs.send_bytes(_READY)
    while True:
        try:
            job = theirs.recv()
        except (EOFError, ConnectionError):
            return
        try:
            answer: tuple[bool, Any] = True, work(*job)
        except Exception as error:
            answer = False, _sendable(error)
        try:
            theirs.send(answer)
        except ConnectionError:
            return
        except Exception as error:  # the value cannot be pickled
            theirs.send((False, RuntimeError(f"the answer cannot be sent: {error}")))


def _sendable(error: Exception) -> Exception:
    """Return an exception that arrives as it was sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def _end_with_parent() -> None:
    """End when the process that asked for this one is gone, killed or not."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def _single_threaded() -> Iterator[None]:
    """Give processes that start meanwhile one thread each: numbers are then the same on every machine."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _allowed_children() -> Iterator[None]:
    """Let a daemonic process, as a dask worker under its nanny is, start one: the child ends with it all the same."""
    config: dict[str, Any] = getattr(multiprocessing.current_process(), "_config", {})
    before = config.get("daemon")
    config["daemon"] = False
    try:
        yield
    finally:
        config["daemon"] = before
