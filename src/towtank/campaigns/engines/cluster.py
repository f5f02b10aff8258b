"""Jobs on the workers of a dask scheduler, on any number of machines. Scheduler and workers are the user's own.

Each thread of a worker keeps a child, a process of its own, and so a reader that aborts takes neither worker nor
neighbours along: its job is tried once more, and then its death is the answer, as on one machine. Workers and
schedulers that die are another matter, nobody's fault: their jobs are given out again. A task knows by itself whether
it is done, so that little is done twice.
"""

from __future__ import annotations

import contextlib
import logging
import pickle
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import towtank
from towtank.campaigns.engines.child import Answer, Child
from towtank.errors import InputError

__all__ = ["Cluster"]

_IN_FLIGHT = 3  # bundles for each thread of a worker that the scheduler holds at a time
_BUNDLE = 0.5  # s
_LARGEST = 100  # jobs in a bundle
_PAUSE = 0.005  # s between two looks
_CONNECT = 10.0  # s, for the first answer of a scheduler
_PATIENCE = 300.0  # s, for a scheduler that is gone to come back
_FIRST_WORKER = 120.0  # s, for a worker to come where there is none
_LOOK = 0.2  # s between two looks for one
_COUNT_AGAIN = 2.0  # s, after which workers are counted again
_GATHER = 60.0  # s, for a worker to hand over what it has done
_DEATHS = 3  # times that a job may be given up by dask, which itself tries it on several workers
_own = threading.local()

Job = tuple[int, tuple[Any, ...]]


@dataclass(frozen=True)
class Cluster:
    """The workers of a scheduler.

    Attributes:
        address: of the scheduler, tcp://HOST:PORT. say: tells a person what is waited for.
    """

    address: str
    say: Callable[[str], None]

    @classmethod
    def at(cls, address: str, say: Callable[[str], None]) -> Cluster:
        """Return the workers of the scheduler at an address.

        Raises:
            InputError: the library is not installed, or no scheduler answers there, or a worker has another version.
        """
        found = cls(address, say)
        client = found._connected(_CONNECT)
        try:
            with contextlib.suppress(OSError):  # it is gone already; `over` says so
                found._same_version(client)
        finally:
            client.close()
        return found

    def over(self, work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]) -> Iterator[Answer]:
        """Yield what comes of each job, in the order in which they are done, `number` counting from 0.

        Raises:
            InputError: a worker has another version of towtank, or none.
            OSError: the scheduler is gone and does not come back.
        """
        flight = _Flight(work, deque(enumerate(jobs)), self._threads)
        patience = _CONNECT
        while flight.waiting:
            client = self._connected(patience)
            patience = _PATIENCE
            try:
                if self._ready(client):
                    yield from flight.until_lost(client)
            finally:
                with contextlib.suppress(Exception):
                    client.close(timeout=2.0)
            if flight.waiting:
                self.say(f"the scheduler {self.address} is gone; waiting up to {_PATIENCE:.0f} s for it to come back")

    def _connected(self, patience: float) -> Any:
        """Return a client of the scheduler, tried for so long [s]. Raises InputError, OSError."""
        try:
            from distributed import Client
        except ImportError:
            raise InputError(
                f"--engine {self.address}: needs the library distributed, which is not installed; install it with "
                'pip install "towtank[fleet]"'
            ) from None
        self._certified()
        for name in [each for each in logging.root.manager.loggerDict if each.startswith("distributed")]:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what matters is said here
        deadline = time.monotonic() + patience
        while True:
            left = deadline - time.monotonic()
            try:
                return Client(self.address, timeout=max(1.0, min(left, _CONNECT)), set_as_default=False)
            except (OSError, TimeoutError) as error:
                if time.monotonic() < deadline:
                    time.sleep(min(1.0, max(0.0, deadline - time.monotonic())))
                    continue
                if patience > _CONNECT:
                    raise OSError(
                        f"{self.address}: the scheduler does not answer any more; once it runs again, the same command "
                        "does the rest"
                    ) from error
                raise InputError(
                    f"--engine {self.address}: no scheduler answers there; start one with dask scheduler, or mend the "
                    "address"
                ) from None
            except ValueError as error:
                raise InputError(f"--engine {self.address}: {error}; expected tcp://HOST:PORT") from None

    def _certified(self) -> None:
        """Raise InputError where TLS is asked for and there are no certificates."""
        from distributed.security import Security

        if not self.address.startswith("tls:"):
            return
        try:
            context = Security().get_connection_args("client")["ssl_context"]
        except OSError as error:
            raise InputError(f"--engine {self.address}: certificates cannot be read ({error})") from None
        if context is None:
            raise InputError(
                f"--engine {self.address}: no certificates are named; dask's configuration names them, as "
                "distributed.comm.tls.ca-file and distributed.comm.tls.client.cert"
            )

    def _ready(self, client: Any) -> bool:
        """Wait until there are workers, all of this version; return False where the scheduler is gone meanwhile."""
        try:
            self._threads(client)
            self._same_version(client)
        except (_Lost, OSError):
            return False
        return True

    def _threads(self, client: Any) -> int:
        """Return how many threads all workers have, once there is one. Raises InputError where none comes, _Lost."""
        began, told = time.monotonic(), False
        while True:
            threads: int = sum(each.get("nthreads", 1) for each in _workers(client).values())
            if threads:
                return threads
            if client.status != "running":
                raise _Lost
            if not told:
                self.say(f"{self.address} has no worker; start one with dask worker {self.address}")
                told = True
            if time.monotonic() - began > _FIRST_WORKER:
                raise InputError(
                    f"--engine {self.address}: no worker came within {_FIRST_WORKER:.0f} s; start one with dask worker "
                    f"{self.address}"
                )
            time.sleep(_LOOK)

    def _same_version(self, client: Any) -> None:
        """Raise InputError for a worker that has another version of towtank, or none; one that dies says neither."""
        names = {address: about.get("name", address) for address, about in _workers(client).items()}
        for address, found in client.run(_version_of, on_error="return").items():
            if found != towtank.__version__ and not isinstance(found, OSError):
                have = f"has towtank {found}" if isinstance(found, str) else "cannot import towtank"
                raise InputError(
                    f"--engine {self.address}: worker {names.get(address, address)} at {address} {have}, expected "
                    f"towtank {towtank.__version__}; install it there"
                )


class _Lost(Exception):
    """The scheduler is gone."""


class _Flight:
    """Jobs on their way through a scheduler, never many at a time.

    Quick ones go in bundles that last about half a second, since each journey costs a scheduler some milliseconds.

    Attributes:
        waiting: jobs that nobody has, with their numbers.

    Args:
        work: what is done with a job. threads: tells of a client how many threads its workers have, once there are any.
    """

    def __init__(self, work: Callable[..., Any], waiting: deque[Job], threads: Callable[[Any], int]) -> None:
        self.waiting = waiting
        self._work = work
        self._threads = threads
        self._flying: dict[Any, list[Job]] = {}
        self._deaths: dict[int, int] = {}
        self._seconds = _BUNDLE  # that a job takes

    def until_lost(self, client: Any) -> Iterator[Answer]:
        """Yield answers until all jobs are done, or the scheduler is gone: then `waiting` has what is not done."""
        threads, counted = 0, -_COUNT_AGAIN
        try:
            while self.waiting or self._flying:
                if time.monotonic() - counted > _COUNT_AGAIN:
                    threads, counted = self._threads(client), time.monotonic()
                while self.waiting and len(self._flying) < _IN_FLIGHT * threads:
                    self._send(client, threads)
                landed = [future for future in self._flying if future.status != "pending"]
                if not landed:
                    time.sleep(_PAUSE)
                if client.status != "running" or any(each.status in ("cancelled", "lost") for each in landed):
                    return
                for future in landed:
                    answers = self._landed(future)
                    del self._flying[future]
                    yield from answers
        except _Lost:
            return
        finally:
            self.waiting.extendleft(job for bundle in reversed(self._flying.values()) for job in reversed(bundle))
            with contextlib.suppress(Exception):
                client.cancel(list(self._flying))
            self._flying.clear()

    def _send(self, client: Any, threads: int) -> None:
        """Give out a bundle of the next jobs; one that workers have died with goes alone."""
        many = max(1, min(int(_BUNDLE / self._seconds), _LARGEST, len(self.waiting) // (2 * threads)))
        bundle = [self.waiting.popleft()]
        while len(bundle) < many and not {bundle[-1][0], self.waiting[0][0]} & self._deaths.keys():
            bundle.append(self.waiting.popleft())
        payload = pickle.dumps((self._work, bundle))  # the scheduler need not know what is in it
        self._flying[client.submit(_performed, payload, towtank.__version__, pure=False)] = bundle

    def _landed(self, future: Any) -> list[Answer]:
        """Return what came of a bundle; jobs that are to be given out again wait again."""
        from concurrent.futures import CancelledError

        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        bundle = self._flying[future]
        try:
            seconds, answers = future.result(timeout=_GATHER)
        except KilledWorker:
            out = []
            for number, job in bundle:
                count = self._deaths[number] = self._deaths.get(number, 0) + 1
                if count < _DEATHS:
                    self.waiting.append((number, job))
                else:
                    out.append(Answer(number, died="with every worker that took it"))
            return out
        except (CancelledError, CommClosedError, TimeoutError) as error:
            raise _Lost from error
        except RuntimeError as error:
            if isinstance(error.__cause__, ModuleNotFoundError):
                raise InputError(
                    f"the scheduler cannot import {error.__cause__.name}; install towtank there"
                ) from error
            raise
        except ModuleNotFoundError as error:
            raise InputError(f"a worker cannot import {error.name}; install towtank there") from error
        self._seconds += 0.3 * (max(seconds / len(bundle), 1e-4) - self._seconds)
        return list(answers)


def _workers(client: Any) -> dict[str, Any]:
    """Return what the scheduler tells of its workers, by address; nothing where it is gone."""
    try:
        return dict(client.scheduler_info(n_workers=-1)["workers"])
    except Exception:
        return {}


# -- on a worker


def _performed(payload: bytes, version: str) -> tuple[float, list[Answer]]:
    """Perform the jobs of a payload in this thread's child, each once more where that dies; return the time too."""
    if towtank.__version__ != version:
        raise InputError(f"worker {_name()}: has towtank {towtank.__version__}, expected {version}; install it there")
    began = time.perf_counter()
    work, bundle = pickle.loads(payload)
    children: dict[Any, Child] = _own.__dict__.setdefault("children", {})
    child = children.get(work)
    if child is None:
        for other in children.values():
            other.close()
        children.clear()
        child = children[work] = Child(work)
    out = []
    for number, job in bundle:
        answer = child.answer(number, job)
        out.append(answer if answer.died is None else child.answer(number, job))
    return time.perf_counter() - began, out


def _name() -> str:
    from distributed import get_worker

    return str(get_worker().name)


def _version_of() -> str:
    return towtank.__version__
