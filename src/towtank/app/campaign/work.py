"""What a task of a campaign does: the same as `towtank learn` or `towtank validate` with its log, or a simulated one.

What goes wrong with a task is the line that the command would print; it is written down, and the campaign goes on.
"""

from __future__ import annotations

import fnmatch
import math
import platform
import time
import tomllib
import warnings
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from towtank.app.tables.learning import supposed_values
from towtank.app.tasks import learn, validate
from towtank.app.terminal.guard import line_of
from towtank.campaigns.cache import fetched, name_of
from towtank.campaigns.configuration import Study
from towtank.campaigns.places import is_remote, without_credentials
from towtank.campaigns.run import Outcome
from towtank.campaigns.store import CHANNELS, Failure, Result, Store
from towtank.campaigns.tasks import Task
from towtank.errors import InputError
from towtank.recording import Recording
from towtank.recording.mapping import ColumnMapping, mapping_of
from towtank.simulation import OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import COEFFICIENTS, Vehicle, mirror
from towtank.vehicle.files import parse_vehicle, vehicle_text

__all__ = ["perform"]

_LONGEST_STEP = 0.01  # s, of the integration
_KEPT = 8  # vehicles that a worker keeps parsed


def perform(task: Task, uri: str) -> Outcome:
    """Do a task and put what comes of it into the store of this URI; a failure is put there too.

    Raises:
        InputError: this machine does not see the store.
        OSError: the store does not take it.
    """
    store, began = _seen(uri), time.perf_counter()
    if store.has(task.id):  # somebody else was quicker
        return Outcome(task.id, 0.0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are in the tables of a single log
            result = _result(task)
    except Exception as error:
        line, code = line_of(error)
        failure = Failure(task.id, task.label, _named(line, task), code)
        store.fail(failure)
        return Outcome(task.id, time.perf_counter() - began, failure)
    seconds = time.perf_counter() - began
    store.put(task, result, seconds)
    return Outcome(task.id, seconds)


def _seen(uri: str) -> Store:
    """Return the store, which has been begun: a worker to which it looks empty has another folder at this path."""
    try:
        return Store.opened(uri)
    except InputError as error:
        raise InputError(f"worker on {platform.node()}: {error}; every worker must see the same store") from None


def _named(line: str, task: Task) -> str:
    """Return a line that names the log as the campaign does, wherever this machine has its copy."""
    if not task.uri or task.label in line:
        return line
    name = name_of(task.uri) if is_remote(task.uri) else Path(task.uri).name
    place = next((word for word in line.split() if word.rstrip(":;,").endswith(name)), "")
    if "/in-use/" in place:
        return line.replace(place.rstrip(":;,"), without_credentials(task.uri))
    return line if place else line.replace("towtank: ", f"towtank: {task.label}: ", 1)


def _result(task: Task) -> Result:
    if task.kind == "simulate-learn" and task.options.study is not None:
        truth, run = _simulated(task, task.options.study)
        return _learned(task, run, {name: truth.coefficient(name) for name in COEFFICIENTS})
    with fetched(task.uri, task.content) as path:
        return _judged(task, path) if task.kind == "validate" else _learned(task, path, {})


def _learned(task: Task, log: Path | Recording, truth: Mapping[str, float]) -> Result:
    options = task.options
    learned = learn(
        log,
        _vehicle(task.text),
        method=options.method,
        free=options.free or None,
        mapping=_mapping(task) if isinstance(log, Path) else None,
        delay=options.delay,
        prior=_vehicle(options.prior) if options.prior else None,
        keep_all=options.keep_all,
    )
    supposed = supposed_values(learned.learning)
    rows = []
    for each in learned.estimate.coefficients:
        prior, prior_std = supposed.get(each.name, (math.nan, math.nan))
        rows.append(
            {
                "coefficient": each.name,
                "value": float(each.value),
                "std": float(each.std),
                "unit": each.unit,
                "prior": float(prior),
                "prior_std": float(prior_std),
                "narrowed": float(learned.learning.narrowed.get(each.name, math.nan)),
                "identified": bool(each.identified),
                "reason": each.reason,
                "truth": truth.get(each.name),
            }
        )
    estimate = learned.estimate
    facts = {
        "delay": float(learned.delay),
        "lag": float(learned.learning.lag),
        "duration": float(estimate.duration),
        "samples": int(estimate.samples),
        "verdict": learned.verdict,
        **_fits(learned.fit),
    }
    return Result(rows, facts, vehicle_text(learned.model))


def _judged(task: Task, log: Path) -> Result:
    options = task.options
    judged = validate(
        _vehicle(task.text),
        log,
        horizon=options.horizon,
        mapping=_mapping(task),
        delay=options.delay,
        keep_all=options.keep_all,
    )
    first, last = judged.window
    return Result((), {"duration": float(last - first), "verdict": judged.verdict, **_fits(judged.fit)})


def _fits(fit: Mapping[str, float | None]) -> dict[str, float | None]:
    return {f"fit_{name}": None if (value := fit.get(name)) is None else float(value) for name in CHANNELS}


def _mapping(task: Task) -> ColumnMapping | None:
    return mapping_of(tomllib.loads(task.options.mapping)) if task.options.mapping else None


@lru_cache(_KEPT)
def _vehicle(text: str) -> Vehicle:
    return parse_vehicle(text, "vehicle of the campaign")


def _simulated(task: Task, study: Study) -> tuple[Vehicle, Recording]:
    """Return the vehicle that a run is of, and the run: drawn from vehicle to vehicle, and from run to run."""
    k, r = task.number
    supposed = _vehicle(task.text)
    own = _varied(supposed, study.between, np.random.default_rng([study.seed, k, 0]))
    truth = _varied(own, study.within, np.random.default_rng([study.seed, k, 1 + r]))
    seed = int(np.random.SeedSequence([study.seed, k, 1 + r]).generate_state(1)[0])
    driven = manoeuvre(study.manoeuvre, supposed, duration=study.duration, dt=1.0 / study.rate, seed=seed)
    run = simulate(
        truth,
        **driven.inputs,
        current=study.current,
        sensors=study.sensors,
        disturbance=OrnsteinUhlenbeck(std=study.disturbance) if study.disturbance else None,
        seed=seed,
        substeps=max(1, round(driven.dt / _LONGEST_STEP)),
    )
    return truth, run


def _varied(vehicle: Vehicle, shares: Mapping[str, float], rng: np.random.Generator) -> Vehicle:
    """Return the vehicle with coefficients multiplied by log-normal factors of these deviations.

    Every coefficient has its own draw, whatever the others: the first pattern that names one counts. Of two mirrored
    added masses, which are one, the first draw counts.
    """
    draws = dict(zip(COEFFICIENTS, rng.standard_normal(len(COEFFICIENTS)), strict=True))
    changes: dict[str, float] = {}
    for name, draw in draws.items():
        share = next((each for pattern, each in shares.items() if fnmatch.fnmatchcase(name, pattern)), 0.0)
        if share and vehicle.coefficient(name) != 0.0 and mirror(name) not in changes:
            changes[name] = vehicle.coefficient(name) * math.exp(share * float(draw))
    return vehicle.with_coefficients(changes) if changes else vehicle
