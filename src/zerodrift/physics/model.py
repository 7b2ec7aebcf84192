"""The physical model: effects with fitted values, and the coefficients of their features."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.records import OPTIONAL
from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.operation import Node
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.rails import bridge
from zerodrift.physics.signals import SignalPlan, build_stretches, name_signals, read_signals
from zerodrift.physics.terms import Term, begin_at_rest, build_features, list_defaults

# The physical model as compensator.json holds it.


@dataclass(frozen=True)
class TermRecord:
    """One effect of a fitted model; see `FittedTerm` and `Term`."""

    kind: str
    signal: str
    values: Mapping[str, float]
    held: frozenset[str]
    std_errors: Mapping[str, float]
    intervals: Mapping[str, tuple[float, float]]
    at_bound: tuple[str, ...]
    arrivals: Mapping[str, int] = field(default_factory=dict, metadata=OPTIONAL)


@dataclass(frozen=True, kw_only=True)
class ModelRecord:
    """A fitted model; see `PhysicalModel` and `SignalPlan`."""

    outputs: tuple[str, ...]
    units: tuple[str, ...]
    full_scale: tuple[float, ...]
    sample_period_s: float
    loaded: tuple[str, ...]
    saturated: tuple[str, ...]
    channels: tuple[str, ...]
    reference_temperature_degC: float
    clock_origin_s: float
    starts_at_first_row: bool = False
    terms: tuple[TermRecord, ...]
    feature_names: tuple[str, ...]
    feature_units: tuple[str, ...]
    coefficients: Array
    std_errors: Array
    offsets: Mapping[str, Array]
    tared: bool
    notes: tuple[str, ...]
    order: tuple[str, ...]


# The physical model: effects with fitted values, and the coefficients of their features.


@dataclass(frozen=True)
class FittedTerm:
    """One effect of a fitted model: values, their errors, and whether a bound stopped the fit."""

    term: Term
    std_errors: Mapping[str, float] = field(default_factory=dict)
    """For fitted parameters only, in the parameter's unit; held ones have none."""
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """95 % interval of each fitted parameter, in the parameter's unit."""
    at_bound: tuple[str, ...] = ()
    """Parameters that the fit pushed against their bounds: not to be trusted."""

    @property
    def kind(self) -> str:
        """The effect's name in zerodrift.toml."""
        return self.term.effect.kind


@dataclass(frozen=True)
class ModelGraph:
    """The model's features as graph nodes, in the order of `PhysicalModel.coefficients`."""

    features: tuple[Node, ...]
    sample_period_s: float


@dataclass(frozen=True)
class PhysicalModel:
    """Drift of output k = sum_j coefficients[j, k] feature_j; feature 0 is the constant."""

    plan: SignalPlan
    units: tuple[str, ...]
    terms: tuple[FittedTerm, ...]
    feature_names: tuple[str, ...]
    feature_units: tuple[str, ...]
    coefficients: Array
    """[J, K] in the output's unit per the feature's unit; row 0 is the constant offset."""
    std_errors: Array
    """[J, K] of the coefficients."""
    offsets: Mapping[str, Array]
    """Run's group -> [K] offset of that run beyond the model, where logs are tared: a nuisance,
    not part of the prediction, whose mean is in the constant."""
    tared: bool
    """Whether each run has an offset of its own."""
    notes: tuple[str, ...] = ()
    """Notes of the fit: parameters at bounds, terms that cannot be distinguished."""
    order: tuple[str, ...] = ()
    """The catalogue's order, in which rewriting effects act."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs, K of them."""
        return self.plan.outputs

    @property
    def effects(self) -> tuple[str, ...]:
        """Kinds of the effects, in the order of the user's file."""
        return tuple(term.kind for term in self.terms)

    @property
    def reference_temperature_degC(self) -> float:
        """T0."""
        return self.plan.reference_temperature_degC

    def features(self, run: Run) -> Array:
        """Return the features [n, J] of one stretch, the constant first.

        Effects with memory continue from the stretches before it; see `Run.at_rest`.
        """
        terms = begin_at_rest([fitted.term for fitted in self.terms])
        (columns,) = build_stretches([run], self.plan, terms, self.order)
        return np.stack([column.signal for column in columns], axis=1)

    def predict(self, run: Run) -> Array:
        """Return the predicted drift [n, K] of one run, each output in its unit."""
        return np.asarray(self.features(run) @ self.coefficients)

    def predict_all(self, runs: Sequence[Run]) -> list[Array]:
        """Return `predict` [n, K] of every run; each chain of stretches is computed once."""
        terms = begin_at_rest([fitted.term for fitted in self.terms])
        return [
            np.stack([column.signal for column in columns], axis=1) @ self.coefficients
            for columns in build_stretches(runs, self.plan, terms, self.order)
        ]

    @property
    def set_aside(self) -> tuple[str, ...]:
        """Outputs whose samples at a converter's rail do not count, by an effect of the model."""
        knows = any(fitted.term.effect.sets_aside for fitted in self.terms)
        return self.plan.saturated if knows else ()

    def find_usable(self, run: Run) -> Mask:
        """Return [n, K] which samples show the drift.

        All of them do unless the model has an effect for a converter's rails (adc_saturation).
        """
        usable = np.ones(run.measured.shape, dtype=bool)
        if self.set_aside:
            for name, flags in read_signals(run, self.plan).saturated.items():
                usable[:, self.outputs.index(name)] = flags == 0.0
        return usable

    def fill_rails(self, run: Run) -> Array:
        """Return the drift [n, K], with samples that are not usable replaced by the prediction."""
        usable = self.find_usable(run)
        drift = run.steady_drift
        if usable.all():
            return drift
        expected = self.predict(run)
        for k in np.flatnonzero(~usable.all(axis=0)):
            flags = (~usable[:, k]).astype(np.float64)
            drift[:, k] = expected[:, k] + bridge(drift[:, k] - expected[:, k], flags)
        return drift

    def graph(self, ops: GraphOperations | None = None) -> ModelGraph:
        """Return the features as graph nodes, which the exporter turns into integers and C.

        Args:
            ops: a graph to add them to; a new one by default.
        """
        ops = ops or GraphOperations(self.plan.sample_period_s)
        signals = name_signals(ops, self.plan)
        features = build_features(ops, signals, [f.term for f in self.terms], self.order)
        return ModelGraph(tuple(f.signal for f in features), self.plan.sample_period_s)

    def to_record(self) -> ModelRecord:
        """Return the model as plain values, ready for JSON."""
        plan = self.plan
        return ModelRecord(
            outputs=plan.outputs,
            units=self.units,
            full_scale=plan.full_scale,
            sample_period_s=plan.sample_period_s,
            loaded=plan.loaded,
            saturated=plan.saturated,
            channels=plan.channels,
            reference_temperature_degC=plan.reference_temperature_degC,
            clock_origin_s=plan.clock_origin_s,
            starts_at_first_row=plan.starts_at_first_row,
            terms=tuple(
                TermRecord(
                    kind=fitted.kind,
                    signal=fitted.term.signal,
                    values=fitted.term.values,
                    held=fitted.term.held,
                    std_errors=fitted.std_errors,
                    intervals=fitted.intervals,
                    at_bound=fitted.at_bound,
                    arrivals=dict(fitted.term.arrivals),
                )
                for fitted in self.terms
            ),
            feature_names=self.feature_names,
            feature_units=self.feature_units,
            coefficients=self.coefficients,
            std_errors=self.std_errors,
            offsets=self.offsets,
            tared=self.tared,
            notes=self.notes,
            order=self.order,
        )

    @staticmethod
    def from_record(record: ModelRecord, catalogue: Catalogue | None = None) -> "PhysicalModel":
        """Return the model that `to_record` described.

        Args:
            record: what `to_record` returned.
            catalogue: needed where the model has a user's own effects.

        Raises:
            InputError: the model has an effect that the catalogue lacks.
        """
        catalogue = catalogue or load_catalogue()
        return PhysicalModel(
            plan=SignalPlan(
                outputs=record.outputs,
                full_scale=record.full_scale,
                sample_period_s=record.sample_period_s,
                loaded=record.loaded,
                saturated=record.saturated,
                channels=record.channels,
                reference_temperature_degC=record.reference_temperature_degC,
                clock_origin_s=record.clock_origin_s,
                starts_at_first_row=record.starts_at_first_row,
            ),
            units=record.units,
            terms=tuple(
                FittedTerm(
                    # A choice that the effect got since then stands at its default.
                    Term(
                        catalogue[term.kind],
                        {**list_defaults(catalogue[term.kind]), **term.values},
                        term.held,
                        term.signal,
                        tuple(term.arrivals.items()),
                    ),
                    term.std_errors,
                    term.intervals,
                    term.at_bound,
                )
                for term in record.terms
            ),
            feature_names=record.feature_names,
            feature_units=record.feature_units,
            coefficients=record.coefficients,
            std_errors=record.std_errors,
            offsets=record.offsets,
            tared=record.tared,
            notes=record.notes,
            order=record.order,
        )
