"""The physical model as compensator.json holds it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from zerodrift.base.arrays import Array
from zerodrift.base.records import OPTIONAL


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
