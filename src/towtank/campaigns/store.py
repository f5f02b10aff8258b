"""Where a campaign's results are kept: plain files under their tasks' names, here or in an object store.

    campaign.json            which campaign this is, and of which version
    plan.parquet             its tasks, as the last run had them
    parts/ID.parquet         what came of a task: a row for each coefficient. The task is done once it is there
    models/ID.toml           the model that was learned
    supposed/HASH.toml       the vehicles that it was learned from, and the prior beside them
    failed/ID.json           the line that says why there is none
    compacted/HASH.parquet   many parts in one

There are no locks and no data base. What a task yields depends on its name alone, and an object is there whole or not
at all, so that whoever does a task twice writes the same again.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import towtank
from towtank.campaigns.configuration import digest
from towtank.campaigns.places import Place, place_of
from towtank.campaigns.tasks import Task
from towtank.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from towtank.campaigns.configuration import Campaign
    from towtank.vehicle import Vehicle

__all__ = ["CHANNELS", "Failure", "Result", "Store", "StoredModel"]

CHANNELS = ("u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi")
_FORMAT = 1
_READERS = 8  # parts that are read at a time
_HEAD, _PLAN, _PARTS, _MODELS, _SUPPOSED, _FAILED, _COMPACTED = (
    *("campaign.json", "plan.parquet", "parts", "models", "supposed", "failed", "compacted"),
)
_KEYS = ("id", "class", "vehicle", "run", "supposed", "beside")  # of the plan
_BATCH = 500  # parts that are put into one table at a time
_AGAIN = 5  # times that parts are looked for which a compaction has moved meanwhile


@dataclass(frozen=True)
class Result:
    """What came of a task.

    Attributes:
        coefficients: a row for each, with some of `coefficient`, `unit`, `value`, `std`, `prior`, `prior_std`,
            `narrowed`, `identified`, `reason`, `truth`; none of a validation.
        facts: of the whole run: `delay`, `lag` [s], `duration` [s], `samples`, `verdict`, `fit_u` .. [%].
        model: the text of the learned vehicle's file, empty where none was learned.
    """

    coefficients: Sequence[Mapping[str, Any]] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    model: str = ""


@dataclass(frozen=True)
class Failure:
    """A task that came to nothing: its name, what it is called, the line that says why, the exit code of that."""

    id: str
    label: str
    line: str
    code: int


@dataclass(frozen=True)
class StoredModel:
    """A model in a store: the task that learned it, the class and the vehicle that it is of, and the run.

    Attributes:
        supposed, beside: hashes of the vehicle that it was learned from, and of the campaign's prior, "" for none.
    """

    id: str
    klass: str
    vehicle: str
    label: str
    supposed: str
    beside: str
    place: Place

    def load(self) -> Vehicle:
        """Return the model. Raises InputError where it is gone or damaged."""
        return self._vehicle(f"{_MODELS}/{self.id}.toml")

    def learned_from(self) -> Vehicle:
        """Return the vehicle that it was learned from. Raises InputError where it is gone or damaged."""
        return self._vehicle(f"{_SUPPOSED}/{self.supposed}.toml")

    def prior(self) -> Vehicle | None:
        """Return what was known beside that, None where nothing was. Raises InputError where it is gone or damaged."""
        return self._vehicle(f"{_SUPPOSED}/{self.beside}.toml") if self.beside else None

    def _vehicle(self, name: str) -> Vehicle:
        from towtank.vehicle.files import parse_vehicle

        data = self.place.read(name)
        if data is None:
            raise InputError(f"{self.place.name}/{name}: no such file; run the campaign again into another store")
        return parse_vehicle(data.decode(), f"{self.place.name}/{name}")


@dataclass(frozen=True)
class Planned:
    """A task as the plan of a store has it; `supposed` and `beside` as a `StoredModel` has them."""

    id: str
    klass: str
    vehicle: str
    label: str
    supposed: str = ""
    beside: str = ""


@dataclass(frozen=True)
class Store:
    """The results of a campaign."""

    place: Place

    @classmethod
    def at(cls, uri: str) -> Store:
        """Return the store of a path or URI, which need not hold anything yet. Raises InputError: no bucket."""
        return cls(place_of(uri))

    @classmethod
    def opened(cls, uri: str) -> Store:
        """Return a store that is there. Raises InputError where none is."""
        store = cls.at(uri)
        store.head  # noqa: B018  says what is wrong with it
        return store

    # -- which campaign

    @cached_property
    def head(self) -> dict[str, Any]:
        """Which campaign the store is of, and of which version. Raises InputError where there is none."""
        data = self.place.read(_HEAD)
        if data is None:
            raise InputError(
                f"{self.place.name}: holds no campaign; towtank campaign run CAMPAIGN.toml --store {self.place.name} "
                "begins one there"
            )
        return self._parsed(data)

    def _parsed(self, data: bytes) -> dict[str, Any]:
        try:
            head = json.loads(data)
            texts = [head["version"], *(head["settings"][name] for name in ("kind", "method"))]
            known = head["format"] == _FORMAT and all(isinstance(each, str) for each in texts)
        except (ValueError, KeyError, TypeError):
            known = False
        if not known:
            raise InputError(
                f"{self.place.name}/{_HEAD}: cannot be read as the head of a campaign; choose another store"
            )
        return dict(head)

    def begin(self, campaign: Campaign, tasks: Iterable[Task]) -> None:
        """Make the store that of a campaign, which it stays, and write down what there is to do.

        Raises:
            InputError: it is of another campaign, or of another version.
        """
        settings = json.loads(json.dumps(campaign.settings))
        data = self.place.read(_HEAD)
        if data is None:
            head = {"format": _FORMAT, "version": towtank.__version__, "settings": settings}
            self.place.write(_HEAD, (json.dumps(head, indent=1) + "\n").encode())
        else:
            self._same(self._parsed(data), settings)
        import pyarrow as pa

        texts, rows = dict[str, str](), []
        for task in tasks:
            supposed, beside = digest(task.text), digest(task.options.prior)
            texts |= {supposed: task.text, beside: task.options.prior}
            about = (task.id, task.klass, task.vehicle, task.label, supposed, beside)
            rows.append(dict(zip(_KEYS, about, strict=True)))
        there = self.place.names(_SUPPOSED, ".toml")
        for name, text in texts.items():
            if name and name not in there:
                self.place.write(f"{_SUPPOSED}/{name}.toml", text.encode())
        plan = _parquet(pa.Table.from_pylist(rows, schema=pa.schema([(name, pa.string()) for name in _KEYS])))
        if self.place.read(_PLAN) != plan:
            self.place.write(_PLAN, plan)

    def _same(self, head: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
        held = head["settings"]
        other = [name for name in {**settings, **held} if held.get(name) != settings.get(name)]
        if other:
            name = other[0]
            plain = all(isinstance(each.get(name), str | int | float) for each in (held, settings))
            told = f" ({held[name]}, not {settings[name]})" if plain and name not in ("map", "prior") else ""
            raise InputError(
                f"{self.place.name}: holds another campaign, one with another {' and '.join(other[:3])}{told}; "
                "choose another --store"
            )
        if head.get("version") != towtank.__version__:
            raise InputError(
                f"{self.place.name}: was begun by towtank {head.get('version')}, this is {towtank.__version__}, and "
                "results of two versions do not mix; choose another --store, or go on with that version"
            )

    @cached_property
    def plan(self) -> tuple[Planned, ...]:
        """What there is to do, as the last run had it. Raises InputError where it is damaged."""
        found = self._rows(_PLAN, _KEYS)
        rows = [] if found is None else found.to_pylist()
        return tuple(Planned(*(row[name] for name in _KEYS)) for row in rows)

    # -- what there is

    def done(self) -> set[str]:
        """Return the names of all tasks that are done."""
        return self.place.names(_PARTS, ".parquet") | self._compacted_ids()

    def _compacted_ids(self) -> set[str]:
        out: set[str] = set()
        for name in self.place.names(_COMPACTED, ".parquet"):
            found = self._rows(f"{_COMPACTED}/{name}.parquet", ("id",))
            if found is not None:
                out |= set(found["id"].unique().to_pylist())
        return out

    def has(self, task: str) -> bool:
        """Whether a task is done, looked up alone; one that was compacted away is not found so."""
        return self.place.exists(f"{_PARTS}/{task}.parquet")

    def failures(self, without: set[str] | None = None) -> list[Failure]:
        """Return what came to nothing, in the order of labels; `without`: names of tasks that are done after all."""
        names = sorted(self.place.names(_FAILED, ".json") - (self.done() if without is None else without))
        with ThreadPoolExecutor(_READERS) as pool:
            rows = [each for each in pool.map(self._failure, names) if each is not None]
        return sorted(rows, key=lambda each: each.label)

    def _failure(self, task: str) -> Failure | None:
        data = self.place.read(f"{_FAILED}/{task}.json")
        if data is None:
            return None
        try:
            found = json.loads(data)
            return Failure(task, str(found["label"]), str(found["line"]), int(found["code"]))
        except (ValueError, KeyError, TypeError):
            raise self._damaged(f"{_FAILED}/{task}.json") from None

    def models(self) -> tuple[StoredModel, ...]:
        """Return the models of the plan's tasks that are there, in the plan's order; each is read when it is loaded."""
        there = self.place.names(_MODELS, ".toml")
        return tuple(
            StoredModel(each.id, each.klass, each.vehicle, each.label, each.supposed, each.beside, self.place)
            for each in self.plan
            if each.id in there
        )

    def table(self) -> pa.Table:
        """Return the rows of all done tasks of the plan, sorted by class, vehicle, run and coefficient."""
        import pyarrow as pa

        labels = {each.id: each.label for each in self.plan}  # a log may have another name by now
        whole, _ = self._parts(set(labels))
        runs = pa.array([labels[each] for each in whole["id"].to_pylist()], pa.string())
        whole = whole.set_column(whole.schema.get_field_index("run"), "run", runs)
        return whole.sort_by([(name, "ascending") for name in ("class", "vehicle", "run", "id", "coefficient")])

    def _parts(self, wanted: set[str] | None) -> tuple[pa.Table, list[str]]:
        """Return the rows of wanted tasks (None: all), each task's once, and the names of the files that hold them.

        Parts are listed before compacted files: what a compaction moves meanwhile is then found there.
        """
        import pyarrow as pa
        import pyarrow.compute as pc

        for _ in range(_AGAIN):
            parts = self.place.names(_PARTS, ".parquet")
            small = sorted(parts if wanted is None else parts & wanted)
            large = sorted(f"{_COMPACTED}/{name}.parquet" for name in self.place.names(_COMPACTED, ".parquet"))
            tables, seen, gone = [schema().empty_table()], set[str](), False
            for name in large:
                table = self._rows(name)
                gone |= table is None
                if table is not None:
                    held = set(table["id"].unique().to_pylist())
                    fresh = (held if wanted is None else held & wanted) - seen
                    tables.append(table.filter(pc.is_in(table["id"], pa.array(sorted(fresh), pa.string()))))
                    seen |= fresh
            single = [f"{_PARTS}/{each}.parquet" for each in small if each not in seen]
            with ThreadPoolExecutor(_READERS) as pool:
                for k in range(0, len(single), _BATCH):
                    asked = single[k : k + _BATCH]
                    found = [table for table in pool.map(self._rows, asked) if table is not None]
                    gone |= len(found) < len(asked)
                    tables.append(pa.concat_tables([tables[0], *found]).combine_chunks())
            if not gone:
                used = [*large, *(f"{_PARTS}/{each}.parquet" for each in small)]
                return pa.concat_tables(tables).combine_chunks(), used
        raise InputError(f"{self.place.name}: is being compacted; try again once that is done")

    def _rows(self, name: str, columns: Sequence[str] = ()) -> pa.Table | None:
        """Return columns of a file of rows, by default those of a part; None where it is gone."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        data = self.place.read(name)
        if data is None:
            return None
        try:
            rows = pq.read_table(io.BytesIO(data), use_threads=False).select(list(columns) or schema().names)
            rows.validate(full=True)
            return rows
        except (pa.ArrowException, KeyError, OSError):
            raise self._damaged(name) from None

    def _damaged(self, name: str) -> InputError:
        return InputError(
            f"{self.place.name}/{name}: damaged, cannot be read as rows of a campaign; remove it, and run the campaign "
            "again"
        )

    # -- what is added

    def put(self, task: Task, result: Result, seconds: float) -> None:
        """Write what came of a task: the model first, since the task counts as done with its part."""
        if result.model:
            self.place.write(f"{_MODELS}/{task.id}.toml", result.model.encode())
        self.place.write(f"{_PARTS}/{task.id}.parquet", _parquet(_rows_of(task, result, seconds)))

    def fail(self, failure: Failure) -> None:
        """Write down that a task came to nothing."""
        self.place.write(f"{_FAILED}/{failure.id}.json", (json.dumps(asdict(failure)) + "\n").encode())

    def forget(self, failures: Iterable[Failure]) -> None:
        """Remove what is written of failures, so that their tasks are done again."""
        for each in failures:
            self.place.remove(f"{_FAILED}/{each.id}.json")

    def compact(self, progress: Callable[[str, float], None] | None = None) -> tuple[int, int]:
        """Put all parts into one file, the plan's and others; return how many there were, and how many are left."""
        report = progress or (lambda text, share: None)
        report("reading", 0.0)
        whole, used = self._parts(None)
        left = len(used)
        if len(used) > 1:
            whole = whole.sort_by([("id", "ascending"), ("coefficient", "ascending")])
            name = hashlib.sha256("\n".join(whole["id"].unique().to_pylist()).encode()).hexdigest()[:32]
            report("writing", 0.4)
            self.place.write(f"{_COMPACTED}/{name}.parquet", _parquet(whole, small=False))
            gone = [each for each in used if each != f"{_COMPACTED}/{name}.parquet"]
            for k, each in enumerate(gone):
                report("removing what is in it", 0.5 + 0.5 * k / len(gone))
                self.place.remove(each)
            left = 1
        for each in ("", _PARTS, _MODELS, _SUPPOSED, _FAILED, _COMPACTED):
            self.place.sweep(each)
        return len(used), left


def schema() -> pa.Schema:
    """Return the columns of every part."""
    import pyarrow as pa

    number, text = pa.float64(), pa.string()
    return pa.schema(
        [
            *((name, text) for name in ("id", "kind", "class", "vehicle", "run")),
            *(("coefficient", text), ("value", number), ("std", number), ("unit", text)),
            *((name, number) for name in ("prior", "prior_std", "narrowed")),
            *(("identified", pa.bool_()), ("reason", text), ("truth", number)),
            *(("delay", number), ("lag", number), ("duration", number), ("samples", pa.int64())),
            *((f"fit_{name}", number) for name in CHANNELS),
            *(("verdict", text), ("seconds", number)),
        ]
    )


def _rows_of(task: Task, result: Result, seconds: float) -> pa.Table:
    """Return the rows of a task; one without a coefficient where there is none."""
    import pyarrow as pa

    about = {"id": task.id, "kind": task.kind, "class": task.klass, "vehicle": task.vehicle, "run": task.label}
    shared = {**about, **result.facts, "seconds": seconds}
    rows = [{**shared, **each} for each in result.coefficients or ({},)]
    columns = schema()
    for row in rows:
        for name in columns.names:
            value = row.get(name)
            row[name] = None if isinstance(value, float) and value != value else value
    return pa.Table.from_pylist(rows, schema=columns)


def _parquet(table: pa.Table, *, small: bool = True) -> bytes:
    """Return a table as Parquet; of a small one, statistics and dictionaries would be more than what it holds."""
    import pyarrow.parquet as pq

    sink = io.BytesIO()
    if small:
        pq.write_table(table, sink, use_dictionary=False, write_statistics=False)
    else:
        pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()
