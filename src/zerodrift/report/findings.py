"""The results of the commands for a project: the one source of figures and tables.

`traces` holds the signals behind the figures, at full rate. Findings can be written to a directory
and read back with the arrays left on disk, so that a page of many million samples opens at once.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array, IntArray
from zerodrift.base.records import UNWRITTEN, from_json, to_dict
from zerodrift.dataset.outliers import COUNTED
from zerodrift.dataset.runs import Run
from zerodrift.diagnosis.advice import Advice
from zerodrift.diagnosis.contribution import Contribution
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.diagnosis import ExplainedDiagnosis
from zerodrift.diagnosis.drivers import measure_slope
from zerodrift.diagnosis.formula.proposal import FormulaCurve
from zerodrift.diagnosis.history import Step
from zerodrift.diagnosis.run_errors import RunError
from zerodrift.diagnosis.summary import ComparisonSummary
from zerodrift.physics.description import EffectDescription
from zerodrift.physics.summary import ModelSummary
from zerodrift.verify.summary import CertificateSummary, FirmwareSummary, StatedUncertainty

FILE_NAME = "findings.json"


@dataclass(frozen=True)
class Trace:
    """One run as the figures show it, its stretches laid end to end."""

    run: str
    held_out: bool
    """Whether the prediction is for data that the model did not learn from."""
    sample_period_s: float
    time_s: Array
    """[n] on the log's own clock."""
    temperature_degC: Array
    """[n] what the chip's thermometer reported."""
    rate_K_per_min: Array
    """[n] slope of the temperature over `RATE_SPAN_S`."""
    load: Array
    """[K, n] true values of the outputs, in their units."""
    drift: Array
    """[K, n] measured minus reference."""
    error: Array
    """[K, n] drift minus model, without the run's own offset."""
    offset: Array
    """[K] what was taken off as the run's own offset; zeros where logs are not tared."""
    outliers: IntArray
    """[M, 2] row and output of each outlier: a sample far off from its neighbours."""
    inputs: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """[C, n] the channels of `Findings.inputs`, in their units."""


@dataclass(frozen=True)
class LoggedInput:
    """A channel of [inputs]."""

    name: str
    """As effects name it."""
    unit: str
    """As the column's name ends; empty where it says none."""


@dataclass(frozen=True)
class SourceFile:
    """A file that the findings were made from."""

    file: str
    """Relative to the project where it lies inside it."""
    use: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """What the findings were made from."""

    files: tuple[SourceFile, ...]
    versions: Mapping[str, str]
    """Package -> version."""
    mark: str
    """One hash of all files."""


@dataclass(frozen=True)
class ProposedFormula:
    """What the last `propose` said of the project as it is."""

    formula: str | None
    """None: there is no formula."""
    sentences: tuple[str, ...]
    curves: Mapping[str, FormulaCurve]
    """Output -> points; empty without a formula."""
    units: Mapping[str, str]


@dataclass(frozen=True)
class Findings:
    """A project, its model and the results of the commands for both."""

    sensor: str
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    full_scale: tuple[float, ...]
    simulated: bool
    """Whether the logs came out of a simulation and not out of a sensor."""
    predictor: str
    """What predicts: physics | compensated | integer | c."""
    comparison: ComparisonSummary
    advice: Advice | None
    """What the logs can teach."""
    comparison_sentences: tuple[str, ...]
    """What the figures are worth."""
    patterns: tuple[str, ...]
    """Where the model fails, in sentences."""
    diagnosed: ExplainedDiagnosis | None
    """None where it was not asked."""
    steps: tuple[Step, ...]
    """The staircase of held-out errors."""
    model: ModelSummary
    firmware: FirmwareSummary | None
    """Of the last `firmware`, where it is current."""
    certificate: CertificateSummary | None
    firmware_note: str
    """Why firmware or certificate are not shown, or why the firmware is an older one."""
    catalogue: Mapping[str, EffectDescription]
    """Effect -> what is declared about it."""
    provenance: Provenance
    notes: tuple[str, ...]
    skip_invalid: bool
    """Whether invalid rows of the logs were dropped."""
    traces: tuple[Trace, ...]
    reviewed: tuple[DataNote, ...] = ()
    """What looks wrong with the logs; the same in words is among the notes."""
    inputs: tuple[LoggedInput, ...] = ()
    """Further channels that every run has."""
    uncertainty: Mapping[str, StatedUncertainty] | None = None
    """Output -> of its compensated value, by the last firmware, where it is current."""
    proposal: ProposedFormula | None = None
    """Of the last `propose`, where it is current."""
    contribution: Contribution | None = field(default=None, metadata=UNWRITTEN)
    """Of the effect that the verdict names, where it was asked for."""

    @property
    def titles(self) -> dict[str, str]:
        """Effect -> the field's term."""
        return {kind: effect.title for kind, effect in self.catalogue.items()}

    def find_trace(self, run: str) -> Trace:
        """Return the trace of a run."""
        return next(trace for trace in self.traces if trace.run == run)


MOVING_K_PER_MIN = 0.1
"""Slower than this counts as neither heating nor cooling, ..."""
MOVING_SHARE = 0.2
"""... or slower than this share of the rate that nine tenths of the time stay below."""


def find_threshold(traces: Sequence[Trace]) -> float:
    """Return the rate in K/min below which these runs are at rest, to one digit."""
    rate = np.concatenate([np.abs(trace.rate_K_per_min) for trace in traces])
    fast = MOVING_SHARE * float(np.quantile(rate, 0.9))
    return float(f"{min(MOVING_K_PER_MIN, fast):.1g}") if fast > 0.0 else MOVING_K_PER_MIN


ARRAYS = (
    "time_s",
    "temperature_degC",
    "rate_K_per_min",
    "load",
    "drift",
    "error",
    "offset",
    "outliers",
    "inputs",
)


def measure_rate(time_s: Array, temperature_degC: Array, period_s: float) -> Array:
    """Return the slope [n] of the temperature in K/min, over a minute around each sample.

    Args:
        time_s: [n] of one uninterrupted stretch.
        temperature_degC: [n].
        period_s: from sample to sample.
    """
    return measure_slope(time_s, temperature_degC, period_s)


def trace_runs(
    errors: Mapping[str, RunError], held_out: Sequence[str], inputs: Sequence[str] = ()
) -> tuple[Trace, ...]:
    """Return the traces of runs, given what the model leaves of them.

    Args:
        errors: run -> its errors.
        held_out: runs whose prediction comes from a model that did not learn from them.
        inputs: channels that every run has.
    """
    return tuple(
        Trace(
            run=error.group,
            held_out=error.group in held_out,
            sample_period_s=error.runs[0].sample_period_s,
            time_s=_join(error.runs, lambda run: run.time_s),
            temperature_degC=_join(error.runs, lambda run: run.temperature_degC),
            rate_K_per_min=_join(
                error.runs,
                lambda run: measure_rate(run.time_s, run.temperature_degC, run.sample_period_s),
            ),
            load=np.ascontiguousarray(np.concatenate([r.reference for r in error.runs]).T),
            drift=np.ascontiguousarray(error.drift.T),
            error=np.ascontiguousarray(error.error.T),
            offset=error.offset,
            outliers=np.argwhere((error.weights < COUNTED) & error.usable),
            inputs=_join_inputs(error.runs, inputs),
        )
        for error in errors.values()
    )


def _join_inputs(runs: Sequence[Run], names: Sequence[str]) -> Array:
    """Return channels [C, n] of a run's stretches."""
    if not names:
        return np.zeros((0, 0))
    return np.stack([np.concatenate([run.inputs[name] for run in runs]) for name in names])


def _join(runs: Sequence[Run], read: Callable[[Run], Array]) -> Array:
    return np.concatenate([read(run) for run in runs])


@dataclass(frozen=True)
class _Head:
    """A trace without its arrays."""

    run: str
    held_out: bool
    sample_period_s: float


@dataclass(frozen=True)
class _Heads:
    traces: tuple[_Head, ...]


def save_findings(findings: Findings, directory: Path) -> None:
    """Write findings into an empty directory: one JSON file, and one file per array."""
    for number, trace in enumerate(findings.traces):
        for name in ARRAYS:
            np.save(directory / f"{number}.{name}.npy", getattr(trace, name), allow_pickle=False)
    told = to_dict(replace(findings, traces=()))
    heads = tuple(_Head(t.run, t.held_out, t.sample_period_s) for t in findings.traces)
    told |= to_dict(_Heads(heads))
    text = json.dumps(told, ensure_ascii=False)
    (directory / FILE_NAME).write_text(text, encoding="utf-8")


def load_findings(directory: Path) -> Findings:
    """Return the findings that `save_findings` wrote; their arrays stay on disk until touched."""
    told = json.loads((directory / FILE_NAME).read_text(encoding="utf-8"))
    traces = tuple(
        Trace(
            **vars(head),
            **{
                name: np.load(directory / f"{number}.{name}.npy", mmap_mode="r", allow_pickle=False)
                for name in ARRAYS
            },
        )
        for number, head in enumerate(from_json(_Heads, told).traces)
    )
    return replace(from_json(Findings, {**told, "traces": []}), traces=traces)
