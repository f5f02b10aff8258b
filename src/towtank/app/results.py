"""What `towtank.learn` and `towtank.validate` return: frozen records that save, report, and show themselves."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, TypeAlias

from towtank.app.commands.arguments import report_place
from towtank.app.files import LogParts, counted
from towtank.app.judging import Judged, write_validate_report
from towtank.app.reports import learn_facts, write_learn_report
from towtank.app.tables.fits import usable_document
from towtank.app.tables.free_motion import left_out_document, left_out_lines
from towtank.app.tables.learning import learn_document, supposed_values
from towtank.digits import estimate_text, measured, percent, short
from towtank.errors import InputError
from towtank.identification import Estimate, Learned, LogLearning
from towtank.intervals import interval, interval_text
from towtank.notebook import html_table, library
from towtank.recording import Recording
from towtank.recording.axes import AxisKnown, known_by
from towtank.recording.consistency import Finding
from towtank.recording.merging.merge import merges_of
from towtank.recording.standard import STANDARD
from towtank.report.sections.prediction import prediction_figures
from towtank.report.verdict import NAMES, learn_verdict, state_of
from towtank.validation import Usability, Validation, predict, score, usability
from towtank.vehicle import Provenance, Vehicle, save_vehicle

__all__ = ["Judgement", "LearnedModel", "Log"]

Log: TypeAlias = str | os.PathLike[str] | Recording
_PREDICTED = "the logs that it was learned from"
_DRAWN = 2  # logs that are drawn
_STYLE = """<style>
.towtank { --measured: #9aa5b0; --blue: #2b8fc9; --line: #8886; --faint: #8883; margin-top: 10px; }
.towtank .grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); gap: 8px 14px; }
.towtank figure { margin: 0; min-width: 0; }
.towtank figure svg { display: block; width: 100%; height: auto; }
.towtank figure svg svg { width: unset; height: unset; }
.towtank .head { display: flex; justify-content: space-between; gap: 12px; font-size: 13px; }
.towtank .head small, .towtank .head span, .towtank .legend { font-weight: 400; opacity: .8; }
.towtank .legend span { margin-right: 18px; font-size: 13px; }
.towtank .legend i { display: inline-block; width: 22px; border-top: 3px solid; margin-right: 8px; }
.towtank .legend i { vertical-align: middle; }
.towtank .legend .measured { border-color: var(--measured); }
.towtank .legend .predicted { border-color: var(--blue); }
.towtank .chart text { font-size: 12px; fill: currentColor; opacity: .8; }
.towtank .tx { text-anchor: middle; }
.towtank .tx.end { text-anchor: end; }
.towtank .ty { text-anchor: end; }
.towtank .chart path { fill: none; }
.towtank .chart .rule { stroke: var(--faint); }
.towtank .chart .zero { stroke: var(--line); }
.towtank .chart .measured { stroke: var(--measured); stroke-width: 2.2; }
.towtank .chart .predicted { stroke: var(--blue); stroke-width: 1.3; }
</style>"""


@dataclass(frozen=True, eq=False, repr=False)
class LearnedModel:
    """A model that was learned from logs.

    Attributes:
        model: the vehicle with what was learned. learning: everything that is known of how it was learned.
        scores, use: of its free-running prediction of these logs, None where they allow none.
        warnings: in plain words. parts: of the logs, what counts. prior: what was known beforehand, as it was named.
        recordings: that it was learned from, as far as they were kept for the report.
    """

    model: Vehicle
    learning: LogLearning
    scores: Validation | None
    use: Usability | None
    warnings: tuple[str, ...]
    parts: tuple[LogParts, ...]
    prior: str | None = None
    recordings: tuple[Recording, ...] = ()

    @classmethod
    def of(
        cls,
        learning: LogLearning,
        parts: Sequence[LogParts],
        recordings: Sequence[Recording],
        warnings: Sequence[str],
        prior: str | None = None,
    ) -> LearnedModel:
        """Return what was learned, with its prediction of the logs.

        Args:
            parts: of the logs. recordings: what was read of them, for a report. warnings, prior: as the attributes.
        """
        model = _with_provenance(learning, [str(each.log) for each in parts], prior)
        scores: Validation | None = None
        use: Usability | None = None
        unfit: tuple[str, ...] = ()
        try:
            free = [predict(model, grid) for grid in learning.grids]
            scores = score(free)
            use = usability(model, learning.grids, free=free)
        except InputError as error:
            unfit = (f"no fit: {error}",)
        return cls(model, learning, scores, use, (*warnings, *unfit), tuple(parts), prior, tuple(recordings))

    @property
    def logs(self) -> tuple[str, ...]:
        """Names of the logs."""
        return tuple(str(each.log) for each in self.parts)

    def __getitem__(self, name: str) -> Learned:
        return self.learning.estimate[name]

    def __repr__(self) -> str:
        estimate = self.estimate
        known = f"{sum(estimate.identified)} of {len(estimate.names)} coefficients"
        logs = self.logs[0] if len(self.logs) == 1 else f"{len(self.logs)} logs"
        return (
            f"<LearnedModel {self.model.name} from {logs}: {known} in {short(estimate.duration)} s, "
            f"method {self.method}\n {self.verdict}>"
        )

    @property
    def estimate(self) -> Estimate:
        """Coefficients with their covariance."""
        return self.learning.estimate

    @property
    def coefficients(self) -> dict[str, Learned]:
        """Every coefficient by its name: `value`, `std`, `unit`, `identified`, `reason`."""
        return {each.name: each for each in self.estimate.coefficients}

    @property
    def method(self) -> str:
        """Method that the coefficients come from."""
        return self.learning.method

    @property
    def delay(self) -> float:
        """From command to force [s]."""
        return self.learning.delay

    @property
    def fit(self) -> dict[str, float | None]:
        """Fit [%] of the free-running prediction of these very logs, None where nothing was measured."""
        return {} if self.scores is None else dict(self.scores.fit)

    @property
    def rmse(self) -> dict[str, float | None]:
        """Root-mean-square error of the same, SI."""
        return {} if self.scores is None else dict(self.scores.rmse)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What cannot be right about the logs or the vehicle, gravest first."""
        return self.learning.findings

    @property
    def known_by(self) -> tuple[AxisKnown, ...]:
        """By which channels the motion along each axis is known."""
        return known_by(*(part for each in self.parts for part in each.parts))

    @property
    def verdict(self) -> str:
        """What is to be known first, in a sentence."""
        return learn_verdict(self.estimate, self.fit, _PREDICTED, self.findings, self.learning.driven, self.use).text

    def document(self) -> dict[str, Any]:
        """Return everything as the document that `towtank learn --json` prints."""
        about: dict[str, Any] = {"vehicle": self.learning.vehicle.name, "logs": list(self.logs), "prior": self.prior}
        about["merged"] = merged_in(self.parts)
        told = learn_document(self.learning, self.fit, self.use, self.warnings, self.rmse, self.known_by)
        return {**about, **left_out_document(self.parts), **told}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model as a vehicle file, whole or not at all. Raises InputError."""
        save_vehicle(self.model, path)

    def report(self, path: str | os.PathLike[str], commands: Sequence[str] = ()) -> None:
        """Write the report, `.html` or `.pdf`.

        Args:
            commands: that make it again, as they shall stand in it.

        Raises:
            InputError: it cannot be written there.
        """
        report_place(place := Path(path))
        facts = learn_facts(
            self.learning,
            self.model,
            self.scores,
            self.recordings,
            use=self.use,
            warnings=self.warnings,
            prior=self.prior,
            left_out=left_out_lines(self.parts),
        )
        write_learn_report(place, facts, _files(self.logs), commands)

    def to_pandas(self) -> Any:
        """Return the coefficients as a `pandas.DataFrame` by name. Raises InputError where pandas is not installed."""
        supposed = supposed_values(self.learning)
        rows = []
        for each in self.estimate.coefficients:
            low, high = interval(each.value, each.std) or (float("nan"), float("nan"))
            mean, std = supposed.get(each.name, (float("nan"), float("nan")))
            told = {"value": each.value, "std": each.std, "low": low, "high": high, "unit": each.unit}
            before = {"prior": mean, "prior_std": std, "narrowed": self.learning.narrowed.get(each.name)}
            rows.append({**told, "identified": bool(each.identified), **before, "reason": each.reason})
        frame = library("pandas", "to_pandas").DataFrame(rows)
        frame.index = list(self.estimate.names)
        frame.index.name = "name"
        return frame

    def _repr_html_(self) -> str:
        """Return the coefficients, what is not known and why, and the prediction beside the measurement."""
        supposed = supposed_values(self.learning)
        rows = [_row(each, supposed) for each in self.estimate.coefficients if each.identified]
        head = ("Coefficient", ">Value", ">± std", ">95 % interval", ">Prior", "Unit", "State")
        reasons: dict[str, list[str]] = {}
        for each in self.estimate.coefficients:
            if not each.identified:
                reasons.setdefault(each.reason or "no reason given", []).append(each.name)
        notes = [f"not identified: {', '.join(names)}: {reason}" for reason, names in reasons.items()]
        table = html_table(self.verdict, head, rows, [*notes, *self.warnings])
        return table + ("" if self.scores is None else _prediction_html(self.scores))


def _row(each: Learned, supposed: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    before = estimate_text(*supposed[each.name]) if each.name in supposed else ""
    value, std = measured(each.value, each.std)
    return each.name, value, std, interval_text(each.value, each.std), before, each.unit, state_of(each)[0]


def merged_in(parts: Sequence[LogParts]) -> list[dict[str, object]]:
    """Return how files were merged into the recordings of logs."""
    return [told for each in parts for told in merges_of(each.recording)]


def _files(logs: Sequence[str]) -> list[Path]:
    """Return the logs that are files or folders."""
    return [path for path in map(Path, logs) if path.exists()]


def _with_provenance(learning: LogLearning, logs: Sequence[str], prior: str | None) -> Vehicle:
    """Return the model with the names of the logs it was learned from."""
    names = ", ".join(PurePath(log).name for log in logs)
    how = f"method {learning.method}, delay {1e3 * learning.delay:.3g} ms"
    beside = "" if prior is None else f", prior {PurePath(prior).name}"
    note = f"learned from {names} ({learning.estimate.duration:.5g} s), {how}{beside}"
    kept = learning.model.provenance
    return learning.model.model_copy(update={"provenance": Provenance(source=kept.source, notes=(*kept.notes, note))})


@dataclass(frozen=True, eq=False, repr=False)
class Judgement:
    """A model judged on logs.

    Attributes:
        name: of the model, as it was given. model: the vehicle. judged: its scores, and what its errors are.
        parts: of the logs, what counts. horizon, delay: [s] as asked for, None where not.
        warnings: in plain words. required: fit [%] that every axis driven and measured must reach, None where none is.
    """

    name: str
    model: Vehicle
    judged: Judged
    parts: tuple[LogParts, ...]
    horizon: float | None = None
    delay: float | None = None
    warnings: tuple[str, ...] = ()
    required: float | None = None

    def __repr__(self) -> str:
        fits = ", ".join(f"{name} {percent(value)}" for name, value in self.fit.items() if value is not None)
        return f"<Judgement {self.name} on {', '.join(self.logs)}: fit {fits or 'unknown'} %\n {self.verdict}>"

    @property
    def logs(self) -> tuple[str, ...]:
        """Names of the logs."""
        return tuple(str(each.log) for each in self.parts)

    @property
    def scores(self) -> Validation:
        """Scores and predictions."""
        return self.judged.found

    @property
    def fit(self) -> dict[str, float | None]:
        """Fit [%] by channel: 100 is perfect, 0 no better than the mean; None where it is not measured."""
        return dict(self.scores.fit)

    @property
    def rmse(self) -> dict[str, float | None]:
        """Root-mean-square error by channel, SI."""
        return dict(self.scores.rmse)

    @property
    def window(self) -> tuple[float, float]:
        """First and last time [s]."""
        return self.scores.window

    @property
    def verdict(self) -> str:
        """What is to be known first, in a sentence."""
        return self.judged.verdict(self.name).text

    @property
    def lacking(self) -> tuple[str, ...]:
        """What does not reach the fit that is required, in words; nothing where none is."""
        return () if self.required is None else self.judged.lacking(self.required)

    @property
    def met(self) -> bool | None:
        """Whether every axis that was driven and measured reaches the fit that is required; None where none is."""
        return None if self.required is None else not self.lacking

    @property
    def merged(self) -> list[dict[str, object]]:
        """How further files were merged into the logs."""
        return merged_in(self.parts)

    def document(self) -> dict[str, Any]:
        """Return everything as the document that `towtank validate --json` prints."""
        about: dict[str, Any] = {"verdict": self.verdict, "usable": usable_document(self.judged.use)}
        about |= {
            "model": self.name,
            "logs": list(self.logs),
            "required": self.required,
            "met": self.met,
            "merged": self.merged,
        }
        scores = {"fit": self.fit, "rmse": self.rmse, "window": self.window}
        asked = {"horizon_s": self.horizon, "delay_s": self.delay}
        told = {**left_out_document(self.parts), **self.judged.document, "warnings": list(self.warnings)}
        return {**about, **scores, **asked, **told}

    def report(self, path: str | os.PathLike[str], commands: Sequence[str] = ()) -> None:
        """Write the report, `.html` or `.pdf`; as `LearnedModel.report`."""
        report_place(place := Path(path))
        recordings, left_out = counted(self.parts), left_out_lines(self.parts)
        further = {
            "horizon": self.horizon,
            "delay": self.delay,
            "warnings": self.warnings,
            "recordings": recordings,
            "left_out": left_out,
        }
        write_validate_report(place, self.name, self.model, self.judged, _files(self.logs), commands, further)

    def to_pandas(self) -> Any:
        """Return fit and error of the channels as a `pandas.DataFrame`. Raises InputError without pandas."""
        rows = [
            {"fit": value, "rmse": self.rmse[name], "unit": STANDARD[name].unit} for name, value in self._known.items()
        ]
        frame = library("pandas", "to_pandas").DataFrame(rows)
        frame.index = list(self._known)
        frame.index.name = "channel"
        return frame

    @property
    def _known(self) -> dict[str, float]:
        return {name: value for name, value in self.fit.items() if value is not None}

    def _repr_html_(self) -> str:
        """Return fits and errors as a table, and the prediction beside the measurement."""
        rows = [
            (f"{name} ({NAMES[name]})", percent(value), short(self.rmse[name], 3), STANDARD[name].unit)
            for name, value in self._known.items()
        ]
        table = html_table(self.verdict, ("Channel", ">Fit %", ">RMS error", "Unit"), rows, self.warnings)
        return table + _prediction_html(self.scores)


def _prediction_html(scores: Validation) -> str:
    """Return the predicted motion beside the measured one, channel by channel, of the first recordings."""
    figures = prediction_figures(scores.predictions, scores.fit, most=_DRAWN)
    return f'{_STYLE}<div class="towtank">{figures}</div>' if figures else ""
