"""What `fleet` prints and keeps in build/fleet/report.json."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from zerodrift.base.records import MEASURED, OPTIONAL
from zerodrift.fleet.result import OutputResult, ParameterResult


@dataclass(frozen=True)
class SpreadSummary:
    """Errors of one output over the sensors of a fleet, in its unit; null where not finite."""

    unit: str
    rmse_uncompensated_median: float = field(metadata=MEASURED)
    rmse_median: float = field(metadata=MEASURED)
    """On held-out data, as the others: of the firmware where there is one."""
    rmse_p95: float = field(metadata=MEASURED)
    rmse_worst: float = field(metadata=MEASURED)
    noise_floor_median: float = field(metadata=MEASURED)
    ratio_median: float = field(metadata=MEASURED)
    """Over the sensor's own noise floor."""
    ratio_worst: float = field(metadata=MEASURED)
    limit: float | None
    """Of [fleet]; null where it sets none."""


@dataclass(frozen=True)
class OutlierSummary:
    """One value of one sensor that is far from the others'."""

    quantity: str
    value: float = field(metadata=MEASURED)
    median: float = field(metadata=MEASURED)
    """Of the fleet."""
    z: float = field(metadata=MEASURED)
    """Robust z-score, signed."""
    unit: str


@dataclass(frozen=True, kw_only=True)
class SensorSummary:
    """One sensor, judged; what no result has is left out."""

    sensor: str
    status: str
    """pass | forced (refused by the gate and written all the same) | fail (refused, or a limit is
    exceeded) | error (there is no result)."""
    reasons: tuple[str, ...]
    outliers: tuple[OutlierSummary, ...]
    kept: bool
    """Whether an earlier run had done it."""
    outputs: Mapping[str, OutputResult] | None = field(default=None, metadata=OPTIONAL)
    parameters: Mapping[str, ParameterResult] | None = field(default=None, metadata=OPTIONAL)
    held_out: str | None = field(default=None, metadata=OPTIONAL)
    """What the errors were measured on, in a sentence."""
    noise_floor_source: str | None = field(default=None, metadata=OPTIONAL)
    """dwell | estimated."""
    network: bool | None = field(default=None, metadata=OPTIONAL)
    vectors: int | None = field(default=None, metadata=OPTIONAL)
    """Steps at which the C was equal to the reference; 0 without firmware."""
    model_hash: str | None = field(default=None, metadata=OPTIONAL)
    temperature_degC: tuple[float, float] | None = field(default=None, metadata=OPTIONAL)
    notes: tuple[str, ...] | None = field(default=None, metadata=OPTIONAL)
    refused: tuple[str, ...] | None = field(default=None, metadata=OPTIONAL)
    forced: bool | None = field(default=None, metadata=OPTIONAL)
    """Whether what the gate refuses was written all the same."""
    warnings: tuple[str, ...] | None = field(default=None, metadata=OPTIONAL)
    floor: str | None = field(default=None, metadata=OPTIONAL)
    """Older name of `noise_floor_source`."""


@dataclass(frozen=True)
class BlocksSummary:
    """One program for all units, and a block of each."""

    design: str
    """The identity of the program's design."""
    bytes: int
    """Of each block."""
    units: int
    """That have a block."""
    vectors: int
    """Steps at which program and block gave the reference's bits."""
    refused: Mapping[str, str]
    """Units without a block, and why."""


@dataclass(frozen=True)
class FleetSummary:
    """All sensors, judged, and how the fleet spreads."""

    SCHEMA: ClassVar = "fleet/1"

    format: int
    design: str
    sensors: int
    passed: int
    forced: int
    failed: int
    errors: int
    outliers: int
    """Sensors that are unlike the others in something."""
    limits: Mapping[str, float]
    ratio_limit: float | None
    outlier_z: float
    outputs: Mapping[str, SpreadSummary]
    results: tuple[SensorSummary, ...]
    blocks: BlocksSummary | None = field(default=None, metadata=OPTIONAL)
    """With `[firmware] coefficients = "block"`: the one program, and the units' blocks."""


@dataclass(frozen=True)
class EffectValues:
    """An effect of one sensor's model."""

    kind: str
    values: Mapping[str, float]
    std_errors: Mapping[str, float]


@dataclass(frozen=True)
class SensorConfiguration:
    """What distinguishes one sensor from the others, for records."""

    sensor: str
    design: str
    model_hash: str
    sample_period_s: float
    effects: tuple[EffectValues, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    features: tuple[str, ...]
    coefficients: tuple[tuple[float, ...], ...]
    """Features by outputs."""
    network: bool
    calibrated_temperature_degC: tuple[float, float]
    errors: Mapping[str, OutputResult]
    held_out: str
    """What the errors were measured on, in a sentence."""
    notes: tuple[str, ...]
