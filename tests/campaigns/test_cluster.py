"""Jobs on their way through a scheduler: a stand-in loses them, kills workers, and is gone at the worst moment."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from towtank.campaigns.engines import cluster
from towtank.campaigns.engines.child import Answer
from towtank.errors import InputError

distributed = pytest.importorskip("distributed")


class Future:
    """What has come of a bundle, known as soon as it is asked for."""

    def __init__(self, status: str, result: Callable[[], Any]) -> None:
        self.status, self._result = status, result

    def result(self, timeout: float) -> Any:
        return self._result()


class Client:
    """A scheduler of two threads; `meets` says what becomes of a bundle of numbers."""

    status = "running"

    def __init__(self, meets: Callable[[list[int]], str]) -> None:
        self.meets, self.sent = meets, list[list[int]]()

    def scheduler_info(self, n_workers: int) -> dict[str, Any]:
        return {"workers": {"tcp://a": {"nthreads": 2}}}

    def submit(self, function: Any, payload: bytes, version: str, *, pure: bool) -> Future:
        _, bundle = pickle.loads(payload)
        numbers = [number for number, _ in bundle]
        self.sent.append(numbers)
        fate = self.meets(numbers)
        if fate == "lost":
            return Future("cancelled", lambda: None)

        def result() -> tuple[float, list[Answer]]:
            if fate == "killed":
                raise distributed.KilledWorker("bundle", None, 3)
            if fate == "no towtank":
                raise RuntimeError("deserialization") from ModuleNotFoundError("No module", name="towtank")
            return 0.001 * len(numbers), [Answer(number, value=number) for number in numbers]

        return Future("finished", result)

    def cancel(self, futures: list[Future]) -> None:
        """Nothing is left to be cancelled."""


def flight(count: int) -> Any:
    return cluster._Flight(len, deque((k, ()) for k in range(count)), lambda client: 2)


def answers(found: Any, client: Client) -> Iterator[Answer]:
    return found.until_lost(client)  # type: ignore[no-any-return]


def test_quick_jobs_travel_in_bundles_that_grow_and_each_is_answered_once() -> None:
    client = Client(lambda numbers: "done")
    found = list(answers(flight(500), client))
    assert sorted(each.number for each in found) == list(range(500))
    assert len(client.sent[0]) == 1
    assert max(map(len, client.sent)) > 20
    assert len(client.sent) < 200


def test_what_a_lost_scheduler_had_waits_again_in_order() -> None:
    whole = flight(100)
    client = Client(lambda numbers: "lost" if 20 in numbers else "done")
    first = list(answers(whole, client))
    left = [number for number, _ in whole.waiting]
    assert left == sorted(left)
    assert sorted([each.number for each in first] + left) == list(range(100))
    second = list(answers(whole, Client(lambda numbers: "done")))
    assert sorted(each.number for each in (*first, *second)) == list(range(100))


def test_a_job_that_takes_all_its_workers_along_is_given_out_alone_and_then_given_up() -> None:
    client = Client(lambda numbers: "killed" if 50 in numbers else "done")
    found = {each.number: each for each in answers(flight(100), client)}
    assert sorted(found) == list(range(100))
    assert [number for number, each in found.items() if each.died] == [50]
    assert client.sent.count([50]) == 2


def test_where_no_worker_is_left_it_is_said_and_after_a_while_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_FIRST_WORKER", 0.01)
    said = list[str]()
    whole = cluster._Flight(len, deque([(0, ())]), cluster.Cluster("tcp://a:1", said.append)._threads)
    client = Client(lambda numbers: "done")
    client.scheduler_info = lambda n_workers: {"workers": {}}  # type: ignore[method-assign]
    with pytest.raises(InputError, match=r"--engine tcp://a:1: no worker came within"):
        list(answers(whole, client))
    assert said == ["tcp://a:1 has no worker; start one with dask worker tcp://a:1"]
    client.status = "closed"
    assert list(answers(whole, client)) == []
    assert [number for number, _ in whole.waiting] == [0]


def test_a_worker_that_dies_while_it_is_asked_is_of_no_other_version() -> None:
    said: dict[str, Any] = {"tcp://a": OSError("timed out"), "tcp://b": cluster.towtank.__version__}

    class Asked(Client):
        def run(self, function: Any, on_error: str) -> dict[str, Any]:
            return said

    whole, client = cluster.Cluster("tcp://a:1", print), Asked(lambda numbers: "done")
    whole._same_version(client)
    said["tcp://b"] = ModuleNotFoundError("No module named 'towtank'")
    with pytest.raises(InputError, match="worker tcp://b at tcp://b cannot import towtank"):
        whole._same_version(client)


def test_tls_without_certificates_is_one_line() -> None:
    with pytest.raises(InputError, match=r"--engine tls://a:1: no certificates are named"):
        cluster.Cluster.at("tls://a:1", print)


def test_a_scheduler_without_towtank_is_told() -> None:
    with pytest.raises(InputError, match="the scheduler cannot import towtank; install towtank there"):
        list(answers(flight(3), Client(lambda numbers: "no towtank")))
