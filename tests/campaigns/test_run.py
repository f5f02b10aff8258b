"""A campaign's run and what is kept of it: only what is missing is done, and nothing is lost."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from towtank.app.campaign.views import status_document
from towtank.app.campaign.work import perform
from towtank.campaigns import Store, read_campaign, run_campaign, tasks_of
from towtank.campaigns.engines.child import Answer
from towtank.campaigns.engines.local import Local
from towtank.campaigns.places import Place
from towtank.campaigns.run import Pace
from towtank.errors import InputError

sys.path.append(str(Path(__file__).parent))  # processes that are started import it too

from campaign_pieces import LEARN, POISON, STUDY, WRONG, abrupt, campaign, log, quick, tasks


class Here:
    """Performs in this very process."""

    def over(self, work: Any, jobs: Any) -> Iterator[Answer]:
        for k, job in enumerate(jobs):
            yield Answer(k, value=work(*job))


def store_of(folder: Path, count: int) -> Store:
    """Return a store whose plan has tasks of nothing."""
    store = Store.at(str(folder / "store"))
    store.begin(read_campaign(campaign(folder, STUDY.format(runs=count, seed=1))), tasks(count))
    return store


def begun(store: Store) -> Counter[int]:
    return Counter(map(int, Path(store.place.root, "begun").read_text().split()))


def test_a_run_does_what_is_missing_and_no_more(tmp_path: Path) -> None:
    store, every = store_of(tmp_path, 9), tasks(9)
    first = run_campaign(every, store, Here(), quick, limit=4)
    assert (first.total, first.before, first.performed, first.left) == (9, 0, 4, 5)
    paces: list[Pace] = []
    second = run_campaign(every, store, Here(), quick, progress=paces.append)
    assert (second.before, second.performed, second.left) == (4, 5, 0)
    assert [each.done for each in paces] == [1, 2, 3, 4, 5]
    assert run_campaign(every, store, Here(), quick).performed == 0
    assert begun(store) == dict.fromkeys(range(9), 1)


def test_a_process_that_aborts_ends_in_failed_and_the_rest_completes(tmp_path: Path) -> None:
    store, every = store_of(tmp_path, 8), tasks(8)
    done = run_campaign(every, store, Local(2), abrupt)
    assert [each.label for each in done.failures] == [f"run-{POISON:03d}", f"run-{WRONG:03d}"]
    assert "killed by SIGABRT" in done.failures[0].line
    assert store.done() == {each.id for each in every} - {each.id for each in done.failures}
    assert [each.line for each in store.failures()] == [each.line for each in done.failures]
    again = run_campaign(every, store, Here(), quick)
    assert (again.performed, len(again.failures)) == (0, 2)
    mended = run_campaign(every, store, Here(), quick, again=True)
    assert (mended.performed, mended.failures) == (2, ())
    assert store.failures() == []


def test_what_a_store_does_not_take_ends_the_run(tmp_path: Path) -> None:
    def full(*_: object) -> None:
        raise OSError("no space left on device")

    class Full:
        def over(self, work: Any, jobs: Any) -> Iterator[Answer]:
            try:
                full()
            except OSError as error:
                yield Answer(0, error=error)

    with pytest.raises(OSError, match="no space left"):
        run_campaign(tasks(3), store_of(tmp_path, 3), Full(), quick)


def test_a_campaign_that_runs_twice_at_once_has_the_same_table(tmp_path: Path) -> None:
    """The second run begins when the first has listed what is done."""
    store, every = store_of(tmp_path, 6), tasks(6)

    class Both(Here):
        def over(self, work: Any, jobs: Any) -> Iterator[Answer]:
            run_campaign(every, store, Here(), quick)
            return super().over(work, jobs)

    run_campaign(every, store, Both(), quick)
    assert begun(store) == dict.fromkeys(range(6), 2)
    assert store.table()["run"].to_pylist() == [each.label for each in every]


def test_a_compacted_store_has_the_same_table_and_goes_on(tmp_path: Path) -> None:
    store, every = store_of(tmp_path, 7), tasks(7)
    run_campaign(every, store, Here(), quick, limit=4)
    before = store.table()
    assert store.compact() == (4, 1)
    assert store.compact() == (1, 1)
    assert store.table().equals(before)
    assert list(Path(store.place.root, "parts").iterdir()) == []
    assert run_campaign(every, store, Here(), quick).performed == 3
    whole = store.table()
    assert store.compact() == (4, 1)
    assert store.table().equals(whole)
    assert store.done() == {each.id for each in every}


def test_what_another_compaction_moves_meanwhile_is_found_and_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, every = store_of(tmp_path, 5), tasks(5)
    run_campaign(every, store, Here(), quick, limit=4)
    whole, names, moved = store.table(), Place.names, list[str]()

    def other(self: Place, folder: str, suffix: str) -> set[str]:
        found = names(self, folder, suffix)
        if not moved:
            moved.append(folder)
            quick(every[len(store.done()) % 5], store.place.uri)
            Store(self).compact()
        return found

    monkeypatch.setattr(Place, "names", other)
    assert store.table()["id"].to_pylist()[:4] == whole["id"].to_pylist()
    moved.clear()
    store.compact()
    assert store.table()["id"].to_pylist() == [each.id for each in every]


def test_a_store_that_never_rests_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = store_of(tmp_path, 2)
    run_campaign(tasks(2), store, Here(), quick)
    monkeypatch.setattr(Store, "_rows", lambda self, name, columns=(): None)
    with pytest.raises(InputError, match="store: is being compacted; try again once that is done"):
        store.compact()


@pytest.mark.parametrize("name", ["plan.parquet", "compacted/a.parquet", "failed/a.json", "campaign.json"])
def test_a_file_of_a_store_that_is_damaged_is_named(name: str, tmp_path: Path) -> None:
    store = store_of(tmp_path, 1)
    store.place.write(name, b"{}")
    with pytest.raises(InputError, match=rf"store/{name}: (damaged|cannot be read as the head)"):
        status_document(Store.opened(store.place.uri))


def test_a_worker_that_does_not_see_the_store_ends_the_run(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^worker on .*: holds no campaign; .* every worker must see the same store"):
        perform(tasks(1)[0], str(tmp_path / "elsewhere"))
    assert list(tmp_path.iterdir()) == []


def test_a_compaction_that_was_killed_before_it_removed_the_parts_loses_and_doubles_nothing(tmp_path: Path) -> None:
    store, every = store_of(tmp_path, 3), tasks(3)
    run_campaign(every, store, Here(), quick)
    parts = {path: path.read_bytes() for path in Path(store.place.root, "parts").iterdir()}
    whole = store.table()
    store.compact()
    for path, data in parts.items():
        path.write_bytes(data)
    assert store.table().equals(whole)


def test_a_part_that_is_damaged_is_named(tmp_path: Path) -> None:
    store = store_of(tmp_path, 1)
    run_campaign(tasks(1), store, Here(), quick)
    path = Path(store.place.root, "parts", f"{tasks(1)[0].id}.parquet")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(InputError, match=rf"{path.name}: damaged, cannot be read as rows of a campaign; remove it"):
        store.table()


def test_half_written_files_of_processes_that_were_killed_are_no_parts_and_are_swept(tmp_path: Path) -> None:
    store = store_of(tmp_path, 1)
    run_campaign(tasks(1), store, Here(), quick)
    old = Path(store.place.root, "parts", ".abc.parquet.x1y2.part")
    new = old.with_name(".abd.parquet.x1y2.part")
    for each in (old, new):
        each.write_bytes(b"PAR1")
    os.utime(old, (1.0, 1.0))
    assert store.done() == {tasks(1)[0].id}
    store.compact()
    assert (old.exists(), new.exists()) == (False, True)


def test_a_store_of_another_campaign_is_refused_by_what_differs(tmp_path: Path) -> None:
    store = store_of(tmp_path, 1)
    other = read_campaign(campaign(tmp_path, STUDY.format(runs=1, seed=2)))
    with pytest.raises(InputError, match="store: holds another campaign, one with another study; choose another"):
        store.begin(other, ())
    other = read_campaign(campaign(tmp_path, STUDY.format(runs=1, seed=1).replace("paper", "joint")))
    with pytest.raises(InputError, match=r"one with another method \(paper, not joint\); choose another --store"):
        store.begin(other, ())


def test_a_store_of_another_version_is_refused(tmp_path: Path) -> None:
    store = store_of(tmp_path, 1)
    head = Path(store.place.root, "campaign.json")
    head.write_text(json.dumps({**json.loads(head.read_text()), "version": "0.0.9"}))
    with pytest.raises(InputError, match=r"store: was begun by towtank 0\.0\.9, this is .*; choose another --store"):
        store_of(tmp_path, 1)


def test_logs_that_are_gone_or_changed_leave_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOWTANK_CACHE", str(tmp_path / "cache"))
    for name in "ab":
        log(tmp_path, f"archive/one/{name}.csv", f"t,u\n0,{name}\n")
    store = Store.at(str(tmp_path / "store"))
    for _ in range(2):
        asked = read_campaign(campaign(tmp_path, LEARN.format(method="paper")))
        found = tasks_of(asked)
        store = Store.at(str(tmp_path / "store"))
        store.begin(asked, found)
        run_campaign(found, store, Here(), quick)
        runs = store.table()["run"].to_pylist()
        (tmp_path / "archive/one/a.csv").unlink(missing_ok=True)
    assert runs == ["archive/one/b.csv"]
    (tmp_path / "archive/one/b.csv").rename(tmp_path / "archive/one/c.csv")
    store.begin(asked, tasks_of(asked))
    assert Store.opened(store.place.uri).table()["run"].to_pylist() == ["archive/one/c.csv"]
    assert len(store.done()) == 2
