"""The physical model: effects with fitted values, and the coefficients of their features."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Run
from zerodrift.operations.backend import GraphOperations
from zerodrift.operations.graph import Node
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.rails import bridge
from zerodrift.physics.signals import SignalPlan, name_signals, read_signals
from zerodrift.physics.terms import Term, build_features
from zerodrift.physics.tracks import build_stretches

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FittedTerm:
    """One effect of a fitted model: values, their errors, and whether a bound stopped the fit."""

    term: Term
    std_errors: Mapping[str, float] = field(default_factory=dict)
    """For fitted parameters only, in the parameter's unit; held ones have none."""
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """95 % interval of each fitted parameter."""
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
    """What the fit has to say: parameters at bounds, terms that cannot be told apart."""
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

        What has a memory remembers the stretches before it; see `Run.at_rest`.
        """
        terms = [fitted.term for fitted in self.terms]
        (columns,) = build_stretches([run], self.plan, terms, self.order)
        return np.stack([column.signal for column in columns], axis=1)

    def predict(self, run: Run) -> Array:
        """Return the predicted drift [n, K] of one run, each output in its unit."""
        return np.asarray(self.features(run) @ self.coefficients)

    def predict_all(self, runs: Sequence[Run]) -> list[Array]:
        """Return `predict` of every run [n, K], each chain of stretches gone through once."""
        terms = [fitted.term for fitted in self.terms]
        return [
            np.stack([column.signal for column in columns], axis=1) @ self.coefficients
            for columns in build_stretches(runs, self.plan, terms, self.order)
        ]

    @property
    def set_aside(self) -> tuple[str, ...]:
        """Outputs whose samples at a converter's rail say nothing, as some effect knows."""
        knows = any(fitted.term.effect.sets_aside for fitted in self.terms)
        return self.plan.saturated if knows else ()

    def find_usable(self, run: Run) -> NDArray[np.bool_]:
        """Return [n, K] which samples say something about the drift.

        All of them do unless the model knows of a converter's rails (adc_saturation).
        """
        usable = np.ones(run.measured.shape, dtype=bool)
        if self.set_aside:
            for name, flags in read_signals(run, self.plan).saturated.items():
                usable[:, self.outputs.index(name)] = flags == 0.0
        return usable

    def fill_rails(self, run: Run) -> Array:
        """Return the drift [n, K], samples that are not usable filled by what the model says."""
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

    def to_dict(self) -> dict[str, Any]:
        """Return the model as plain lists and numbers, ready for JSON."""
        plan = self.plan
        return {
            "outputs": list(plan.outputs),
            "units": list(self.units),
            "full_scale": list(plan.full_scale),
            "sample_period_s": plan.sample_period_s,
            "loaded": list(plan.loaded),
            "saturated": list(plan.saturated),
            "channels": list(plan.channels),
            "reference_temperature_degC": plan.reference_temperature_degC,
            "clock_origin_s": plan.clock_origin_s,
            "starts_at_first_row": plan.starts_at_first_row,
            "terms": [
                {
                    "kind": fitted.kind,
                    "signal": fitted.term.signal,
                    "values": dict(fitted.term.values),
                    "held": sorted(fitted.term.held),
                    "std_errors": dict(fitted.std_errors),
                    "intervals": {k: list(v) for k, v in fitted.intervals.items()},
                    "at_bound": list(fitted.at_bound),
                }
                for fitted in self.terms
            ],
            "feature_names": list(self.feature_names),
            "feature_units": list(self.feature_units),
            "coefficients": self.coefficients.tolist(),
            "std_errors": self.std_errors.tolist(),
            "offsets": {group: offset.tolist() for group, offset in self.offsets.items()},
            "tared": self.tared,
            "notes": list(self.notes),
            "order": list(self.order),
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any], catalogue: Catalogue | None = None) -> "PhysicalModel":
        """Return the model that `to_dict` wrote.

        Args:
            data: what `to_dict` returned.
            catalogue: needed where the model has a user's own effects.

        Raises:
            InputError: the model has an effect that the catalogue lacks.
        """
        catalogue = catalogue or load_catalogue()
        return PhysicalModel(
            plan=SignalPlan(
                outputs=tuple(data["outputs"]),
                full_scale=tuple(data["full_scale"]),
                sample_period_s=data["sample_period_s"],
                loaded=tuple(data["loaded"]),
                saturated=tuple(data["saturated"]),
                channels=tuple(data["channels"]),
                reference_temperature_degC=data["reference_temperature_degC"],
                clock_origin_s=data["clock_origin_s"],
                starts_at_first_row=data.get("starts_at_first_row", False),
            ),
            units=tuple(data["units"]),
            terms=tuple(
                FittedTerm(
                    Term(
                        catalogue[term["kind"]],
                        dict(term["values"]),
                        frozenset(term["held"]),
                        term["signal"],
                    ),
                    dict(term["std_errors"]),
                    {k: (v[0], v[1]) for k, v in term["intervals"].items()},
                    tuple(term["at_bound"]),
                )
                for term in data["terms"]
            ),
            feature_names=tuple(data["feature_names"]),
            feature_units=tuple(data["feature_units"]),
            coefficients=np.array(data["coefficients"], dtype=np.float64),
            std_errors=np.array(data["std_errors"], dtype=np.float64),
            offsets={k: np.array(v, dtype=np.float64) for k, v in data["offsets"].items()},
            tared=data["tared"],
            notes=tuple(data["notes"]),
            order=tuple(data["order"]),
        )


def combine_offsets(offsets: Sequence[Array]) -> Array:
    """Return the mean [K] of the runs' offsets, each run counting once."""
    return np.asarray(np.mean(np.stack(offsets), axis=0))
