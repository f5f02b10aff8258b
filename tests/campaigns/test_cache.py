"""The cache of remote logs: bounded, the least recently used go first, and nobody loses a log that is in use."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest
from pyarrow.fs import LocalFileSystem

from towtank.campaigns import cache
from towtank.campaigns.cache import fetched
from towtank.campaigns.places import Place
from towtank.errors import InputError

SIZE = 100_000  # bytes of a log


class Store:
    """An object store that is a folder here, and counts what is taken from it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.taken = folder, list[str]()
        folder.mkdir()

    def put(self, name: str, letter: str) -> tuple[str, str]:
        """Return URI and hash of a new log."""
        data = letter.encode() * SIZE
        (self.folder / name).write_bytes(data)
        return f"s3://archive/{name}", hashlib.sha256(data).hexdigest()

    def place(self, uri: str) -> Place:
        name = uri.rpartition("/")[2]
        self.taken.append(name)
        return Place(uri, uri, LocalFileSystem(), str(self.folder / name))


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    made = Store(tmp_path / "store")
    monkeypatch.setenv("TOWTANK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TOWTANK_CACHE_GB", str(2.5 * SIZE / 1e9))
    monkeypatch.setattr(cache, "place_of", made.place)
    return made


def use(log: tuple[str, str], at: float) -> None:
    """Take a log, which was last used at a time [s], whatever the clock of the disk resolves."""
    with fetched(*log) as path:
        assert hashlib.sha256(path.read_bytes()).hexdigest() == log[1]
        assert path.name == log[0].rpartition("/")[2]
    kept = cache.folder() / "logs" / log[1]
    if kept.exists():
        os.utime(kept, (at, at))


def held() -> int:
    return sum(each.stat().st_size for each in (cache.folder() / "logs").iterdir())


def test_the_least_recently_used_goes_first_and_the_bound_holds(store: Store) -> None:
    a, b, c = (store.put(f"{name}.csv", name) for name in "abc")
    use(a, 1.0)
    use(b, 2.0)
    use(a, 3.0)
    assert store.taken == ["a.csv", "b.csv"]  # the third from the cache
    use(c, 4.0)
    assert held() == 2 * SIZE
    use(a, 5.0)
    assert store.taken == ["a.csv", "b.csv", "c.csv"]  # b made room
    use(b, 6.0)
    assert store.taken[-1] == "b.csv"
    assert held() == 2 * SIZE


def test_a_log_in_use_stays_though_the_cache_forgets_it(store: Store) -> None:
    a, b, c = (store.put(f"{name}.csv", name) for name in "abc")
    with fetched(*a) as path:
        use(b, 2e9)
        use(c, 3e9)
        assert not (cache.folder() / "logs" / a[1]).exists()
        assert path.read_bytes() == b"a" * SIZE
    assert not path.exists()
    assert list((cache.folder() / "in-use").iterdir()) == []


def test_a_log_larger_than_the_cache_is_had_and_not_kept(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOWTANK_CACHE_GB", str(0.5 * SIZE / 1e9))
    a = store.put("a.csv", "a")
    use(a, 1.0)
    use(a, 2.0)
    assert store.taken == ["a.csv", "a.csv"]
    assert not (cache.folder() / "logs").exists()


def test_a_log_that_is_no_longer_the_same_is_refused_and_not_kept(store: Store) -> None:
    uri, _ = store.put("a.csv", "a")
    with pytest.raises(InputError, match=r"^s3://archive/a.csv: changed since the campaign began"), fetched(uri, "0"):
        pass
    assert not (cache.folder() / "logs").exists()


@pytest.mark.parametrize("told", ["much", "-1", "0", "nan"])
def test_a_bound_that_is_none_is_said(told: str, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    a = store.put("a.csv", "a")
    monkeypatch.setenv("TOWTANK_CACHE_GB", told)
    with pytest.raises(InputError, match=f'TOWTANK_CACHE_GB: found "{told}", expected a number'), fetched(*a):
        pass
