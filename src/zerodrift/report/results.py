"""What each command finds: one frozen record per command, which `--json` writes as it is.

`base.records` describes them; `docs/reference/schemas` holds the descriptions.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from zerodrift.base.records import OPTIONAL, SCHEMA_KEY, from_json, get_schema_name
from zerodrift.base.shown import Shown
from zerodrift.calibration.files import CalibrationSummary
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.diagnosis.formula.proposal import FormulaCurve
from zerodrift.diagnosis.remainder import RemainderPattern
from zerodrift.diagnosis.summary import (
    AdviceSummary,
    ComparisonSummary,
    RevisionSummary,
    StepSummary,
)
from zerodrift.discovery.summary import PlanSummary
from zerodrift.field.summary import (
    MonitorResult,
    NeighbourResult,
    RegistryResult,
    UnitHistoryResult,
)
from zerodrift.fleet.joint_summary import FleetDiagnosis
from zerodrift.fleet.summary import FleetSummary
from zerodrift.physics.description import EffectDescription
from zerodrift.physics.summary import FittedCoefficient, ModelSummary, ParameterInterval
from zerodrift.recording.status import RecordingSummary
from zerodrift.report.datasheet import DatasheetRow
from zerodrift.report.findings import Provenance
from zerodrift.train.scores import ContractingCost
from zerodrift.train.summary import NetworkChoice, TrainingSummary
from zerodrift.verify.machine import Item
from zerodrift.verify.summary import (
    CertificateSummary,
    ChipError,
    FirmwareSummary,
    LogsRefused,
    StatedUncertainty,
    Statement,
    VerifySummary,
)


@dataclass(frozen=True, kw_only=True)
class CompareResult(ComparisonSummary, Shown):
    """The model against the measurements, run by run and output by output."""

    SCHEMA: ClassVar = "compare/1"

    model: str
    """What predicted: physics | compensated | integer | c."""
    advice: AdviceSummary | None
    """What the logs can teach; null where no output moves."""
    notes: tuple[DataNote, ...]
    """What looks wrong with the logs: run, column, rows, what it looks like, what to do."""
    chip_error: Mapping[str, ChipError] | None = field(default=None, metadata=OPTIONAL)
    """Of the last firmware, where it is current."""
    warnings: tuple[Statement, ...] | None = field(default=None, metadata=OPTIONAL)
    """Of the last firmware, where it is current."""
    uncertainty: Mapping[str, StatedUncertainty] | None = field(default=None, metadata=OPTIONAL)
    """Output -> of its compensated value, by the last firmware, where it is current."""


@dataclass(frozen=True)
class ThermometerSummary:
    """A further thermometer that the drift follows."""

    ALIASES: ClassVar = ("heldout_rmse_ratio",)

    signal: str
    """Its name in [inputs]."""
    rmse_left_out_ratio: float
    """RMSE on data held out with a zero shift that follows it, over that without."""
    command: str
    """What adds it, as a shell takes it."""
    reason: str

    @property
    def heldout_rmse_ratio(self) -> float:
        """Older name of `rmse_left_out_ratio`."""
        return self.rmse_left_out_ratio


@dataclass(frozen=True, kw_only=True)
class DiagnosisStep(Diagnosis):
    """One diagnosis."""

    command: str
    """What adds the missing effect, as a shell takes it; "" where none is named."""


@dataclass(frozen=True)
class AddedEffect:
    """An effect that `diagnose --auto` added, without writing it."""

    effect: str
    parameters: Mapping[str, float]
    command: str
    """What adds it, as a shell takes it."""


@dataclass(frozen=True, kw_only=True)
class DiagnoseResult(DiagnosisStep, Shown):
    """Which effect the model lacks."""

    SCHEMA: ClassVar = "diagnose/1"

    thermometers: tuple[ThermometerSummary, ...]
    """Further thermometers that the drift follows, the best first."""
    advice: AdviceSummary | None
    """What the logs can teach; null where no output moves."""
    added: tuple[AddedEffect, ...] | None = field(default=None, metadata=OPTIONAL)
    """With --auto: what was added, one after the other."""
    steps: tuple[DiagnosisStep, ...] | None = field(default=None, metadata=OPTIONAL)
    """With --auto: each diagnosis, the last one last."""


@dataclass(frozen=True)
class ProposedError:
    """RMSE of one output on runs left out, in its unit."""

    unit: str
    before: float
    after: float | None
    """With the formula; null where none is found."""
    noise_floor: float


@dataclass(frozen=True)
class ProposedRival:
    """A formula that these runs cannot distinguish from the proposed one."""

    name: str
    """Another formula."""
    apart: float
    """RMS difference of the two predictions in the runs, in units of the noise."""
    equal: bool
    """Whether that is less than a tenth."""


@dataclass(frozen=True)
class ProposedCost:
    """What a formula adds to the C of the physical model; empty where that is not known."""

    instructions: Mapping[str, int]
    """Core -> instructions more in a step."""
    flash_bytes: Mapping[str, int]
    """Core -> bytes of flash more."""
    rounding: Mapping[str, float]
    """Output -> RMS difference of the integers from the float model in the first run, its unit."""


@dataclass(frozen=True)
class ProposedBlackBox:
    """Errors of a black box that sees every signal, on runs that it did not learn from."""

    name: str
    """lag bank | GRU."""
    sees: str
    """The signals that it was given."""
    rmse_left_out: Mapping[str, float]
    """Output -> RMSE in the formula's place, beside the model as it is, in the output's unit."""
    rmse_beside: Mapping[str, float] | None
    """Output -> RMSE beside model and formula; null without a formula."""
    floor_ratio: float
    """`rmse_left_out` over the noise floor, pooled over outputs."""
    floor_ratio_beside: float | None
    """The same of `rmse_beside`."""
    learns_more: bool
    """Whether it is better than the formula, in its place or beside it, by what `add` asks of a
    change; without a formula, than the model as it is."""
    reason: str
    """Why, in a sentence."""


@dataclass(frozen=True, kw_only=True)
class ProposeResult:
    """A formula for a drift that no effect of the catalogue explains, or that there is none."""

    SCHEMA: ClassVar = "propose/1"

    found: bool
    kind: str | None
    """The name of the effect that it would be."""
    formula: str | None
    """With its numbers; k is each output's own."""
    parameters: Mapping[str, ParameterInterval]
    coefficients: tuple[FittedCoefficient, ...]
    """k of each output."""
    rmse_left_out: Mapping[str, ProposedError]
    """Output -> its errors."""
    floor_ratio_before: float
    """RMSE on runs left out over the noise floor, pooled over outputs."""
    floor_ratio_after: float
    p_value: float | None
    """How often the best of everything tried does as well when signs of whole runs are flipped;
    null where nothing was tried."""
    probability: float | None
    """1 less the p-value: that chance among all that was tried does not do as well; null without a
    formula. That the formula is the cause it does not say."""
    forms_tried: int
    columns_tried: int
    """Formulas times values of their numbers."""
    lookalikes: tuple[ProposedRival, ...]
    suffices: str | None
    """The effect of the catalogue that does as well; null where none does."""
    nearest: str | None
    """Without a formula: the one that came nearest."""
    reason: str
    physics: str
    """What kind of physics has this form."""
    next_experiment: str
    """What would confirm or refute it."""
    remainder: tuple[RemainderPattern, ...]
    """Without a formula: what is left follows these."""
    black_boxes: tuple[ProposedBlackBox, ...]
    """How much more a lag bank and a GRU learn; empty where none was tried."""
    black_box_note: str
    """Why one was not tried; empty where both were."""
    curves: Mapping[str, FormulaCurve]
    """Output -> what the model leaves against what the formula says of it; empty without one."""
    instructions: Mapping[str, int]
    """Core -> instructions that it adds to a step; empty where that could not be told."""
    flash_bytes: Mapping[str, int]
    """Core -> bytes of flash that it adds."""
    rounding: Mapping[str, float]
    """Output -> RMS difference of the integers from the float model, in its unit."""
    cost_note: str
    """Why the cost could not be told; empty where it is."""
    written: str | None
    """The effect's file."""


@dataclass(frozen=True, kw_only=True)
class PlanResult(PlanSummary, Shown):
    """The next experiment: a programme of set points, and what it is expected to show."""

    SCHEMA: ClassVar = "plan/1"


@dataclass(frozen=True, kw_only=True)
class RecordResult(RecordingSummary, Shown):
    """A log that was recorded, and what it covers."""

    SCHEMA: ClassVar = "record/1"

    taught: tuple[str, ...]
    """What the project's logs can teach now, in sentences; empty where they cannot be read yet."""


@dataclass(frozen=True, kw_only=True)
class AddResult(RevisionSummary, Shown):
    """An effect was added; the errors before and after."""

    SCHEMA: ClassVar = "add/1"

    added: bool
    """Whether zerodrift.toml has it now."""


@dataclass(frozen=True, kw_only=True)
class RemoveResult(RevisionSummary, Shown):
    """An effect was removed; the errors before and after."""

    SCHEMA: ClassVar = "remove/1"

    removed: bool = True


@dataclass(frozen=True)
class HistoryResult(Shown):
    """The staircase of errors so far."""

    SCHEMA: ClassVar = "history/1"

    steps: tuple[StepSummary, ...]


@dataclass(frozen=True, kw_only=True)
class TrainResult(TrainingSummary, Shown):
    """What training achieved, per output."""

    SCHEMA: ClassVar = "train/1"

    advice: AdviceSummary | None
    """What the logs can teach; null where no output moves."""
    choice: NetworkChoice | None = None
    """With `[network] kind = "auto"`: what was tried, and what it took."""
    contracting: ContractingCost | None = None
    """With `[network] contracting = true`: what it costs."""


@dataclass(frozen=True)
class ExportResult:
    """The integer model, written and proven."""

    SCHEMA: ClassVar = "export/1"

    model_hash: str
    bounds_proven: int
    files: tuple[str, ...]


@dataclass(frozen=True)
class ShownBlock:
    """The fields of a unit's block."""

    file: str
    serial: str
    design: str
    """The first 16 digits of the design's identity."""
    calibrated: str
    """YYYY-MM-DD."""
    sequence: int
    """Of two slots the larger is newer."""
    bytes: int
    crc: int
    known_design: bool
    """Whether design.json was found, so that the numbers could be held against the set."""
    fields: Mapping[str, tuple[int, ...]]
    """Field -> its numbers; empty without the design."""


@dataclass(frozen=True)
class BlockResult:
    """Blocks, each of them sound (`block show`)."""

    SCHEMA: ClassVar = "block/1"

    blocks: tuple[ShownBlock, ...]


@dataclass(frozen=True)
class CertificateResult:
    """Which claims of certificate.json hold (`verify --certificate`)."""

    SCHEMA: ClassVar = "verify-certificate/1"

    certificate: str
    """holds | refused."""
    claims_that_hold: int
    failures: tuple[str, ...]


@dataclass(frozen=True)
class ProvenPart:
    """One thing that the C or a kernel's object code does, held against the specification for every
    input."""

    what: str
    """A function, a node, a table or a kernel."""
    build: str
    """Of which way to compile it, or which program; "" for all of them."""
    verdict: str
    """proven | tested, not proven | not proven."""
    why: str
    """Why it is not proven; of what is tested, what a proof lacked here, if anything; else ""."""


@dataclass(frozen=True)
class ProofResult(Shown):
    """Whether the C is the specification, part by part (`verify --prove`)."""

    SCHEMA: ClassVar = "verify-prove/1"

    proven: bool
    """No part is `not proven`; parts that are only tested are listed."""
    model_hash: str
    parts: tuple[ProvenPart, ...]


@dataclass(frozen=True)
class OutputApplied:
    """One output over a log, in its unit."""

    unit: str
    rms_drift: float
    largest_drift: float
    uncertainty: float | None
    """Median expanded uncertainty (k = 2); None where none is known."""


@dataclass(frozen=True)
class AppliedLog:
    """The answers of a model to one log."""

    log: str
    file: str
    rows: int
    steps: int
    """Steps of the firmware."""
    outputs: Mapping[str, OutputApplied]
    flags: Mapping[str, int]
    """Flag, in words -> steps that carry it."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ApplyResult:
    """The finished model over logs, as the chip would run it."""

    SCHEMA: ClassVar = "apply/1"

    model: str
    """integer | float."""
    model_hash: str
    logs: tuple[AppliedLog, ...]
    notes: tuple[str, ...]
    uncertainty: Mapping[str, StatedUncertainty] | None = field(default=None, metadata=OPTIONAL)
    """Output -> of its compensated value inside the calibrated ranges, by cause."""


@dataclass(frozen=True)
class PackageResult:
    """The model as a package of a build system."""

    SCHEMA: ClassVar = "package/1"

    package: str
    """cmake | zephyr | arduino | platformio."""
    model_hash: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class DoctorResult:
    """What this machine has and lacks."""

    SCHEMA: ClassVar = "doctor/1"

    can_check: bool
    """Whether firmware can be built and checked here on the host and on a core."""
    items: tuple[Item, ...]


@dataclass(frozen=True)
class EffectsResult:
    """The catalogue of physical effects."""

    SCHEMA: ClassVar = "effects/1"

    effects: tuple[EffectDescription, ...]


@dataclass(frozen=True, kw_only=True)
class EffectResult(EffectDescription):
    """One effect (`effects NAME`)."""

    SCHEMA: ClassVar = "effect/1"


@dataclass(frozen=True)
class GuessedColumns:
    """An output as `init` guessed it."""

    measured: str
    reference: str | float | None
    """A column or a number; null where there is none."""
    unit: str
    full_scale: float


@dataclass(frozen=True)
class InitColumn:
    """A column of the logs as `init` saw it."""

    file: str
    column: str
    role: str
    unit: str
    low: float | None
    high: float | None
    why: str


@dataclass(frozen=True)
class InitResult:
    """What `init` guessed from the logs and wrote."""

    SCHEMA: ClassVar = "init/1"

    file: str
    time: str
    temperature: str
    sample_period_s: float
    outputs: Mapping[str, GuessedColumns]
    inputs: Mapping[str, str]
    logs: Mapping[str, tuple[str, ...]]
    """train | test | dwell -> selectors."""
    check: tuple[str, ...]
    """What to look at, in sentences."""
    columns: tuple[InitColumn, ...]
    """What was seen of each column of the first run."""


@dataclass(frozen=True)
class UpgradedInput:
    """The codes of an input that zerodrift.toml states now."""

    column: str
    raw: str
    """int16 or int32."""
    lsb: float
    """One code, in the column's unit."""


@dataclass(frozen=True)
class UpgradeResult:
    """What `init --upgrade` wrote into zerodrift.toml."""

    SCHEMA: ClassVar = "upgrade/1"

    file: str
    units: int
    """Of the fleet, whose logs all fit; 1 for a project."""
    changed: Mapping[str, UpgradedInput]
    """Input, or `[sensor] temperature` -> its codes, which followed from logs."""
    kept: Mapping[str, str]
    """Input -> why its codes do not follow from logs."""
    format_before: int
    """Of zerodrift.toml; nothing was written where it was `format` and nothing changed."""
    format: int


@dataclass(frozen=True, kw_only=True)
class CalibrateResult(CalibrationSummary):
    """A calibration matrix, and its residuals."""

    SCHEMA: ClassVar = "calibrate/1"

    files: tuple[str, ...]


@dataclass(frozen=True)
class ModelChange:
    """Something that two models state differently."""

    what: str
    """sample period | channel NAME | output NAME | calibrated range of NAME | effect NAME | ..."""
    old: str
    """"" where the old model has nothing of the kind."""
    new: str
    """"" where the new model has nothing of the kind."""


@dataclass(frozen=True)
class OutputDifference:
    """By how much two models' drifts differ on one output, in its unit."""

    unit: str
    largest: float
    rms: float
    largest_pct_fs: float
    """The largest, in % of the new model's full scale."""


@dataclass(frozen=True)
class DiffResult:
    """What changed between two models, and by how much their drifts differ."""

    SCHEMA: ClassVar = "diff/1"

    old: str
    new: str
    same: bool
    """Whether both are the same model, bit for bit."""
    changes: tuple[ModelChange, ...]
    over: str
    """What the difference was taken over: logs, or the calibrated range."""
    outputs: Mapping[str, OutputDifference]
    limit_pct_fs: float | None
    exceeds: bool
    """Whether a difference is larger than the limit."""
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class ReportResult:
    """All that is known about a sensor and its model."""

    SCHEMA: ClassVar = "report/1"

    sensor: str
    simulated: bool
    compare: CompareResult
    compare_sentences: tuple[str, ...]
    patterns: tuple[str, ...]
    diagnose: DiagnoseResult | None
    diagnose_sentences: tuple[str, ...]
    history: HistoryResult
    model: ModelSummary
    firmware: FirmwareSummary | None
    certificate: CertificateSummary | None
    firmware_note: str
    titles: Mapping[str, str]
    catalogue: Mapping[str, EffectDescription]
    provenance: Provenance
    notes: tuple[str, ...]
    skip_invalid: bool
    files: tuple[str, ...]
    datasheet: tuple[DatasheetRow, ...] | None = field(default=None, metadata=OPTIONAL)


RESULTS: tuple[type, ...] = (
    BlockResult,
    *(AddResult, ApplyResult, CalibrateResult, CertificateResult, CompareResult, DiagnoseResult),
    *(DiffResult, DoctorResult),
    *(EffectResult, EffectsResult, ExportResult, FirmwareSummary, HistoryResult),
    LogsRefused,
    *(FleetDiagnosis, FleetSummary),
    *(
        InitResult,
        MonitorResult,
        NeighbourResult,
        PackageResult,
        PlanResult,
        ProofResult,
        ProposeResult,
        RecordResult,
        RegistryResult,
        RemoveResult,
        ReportResult,
        TrainResult,
        UpgradeResult,
        UnitHistoryResult,
        VerifySummary,
    ),
)
"""Every record that a command writes with `--json`."""


def is_done(revision: AddResult | RemoveResult) -> bool:
    """Return whether zerodrift.toml was changed."""
    return revision.removed if isinstance(revision, RemoveResult) else revision.added


def read_result(text: str) -> object | None:
    """Return the record that a command printed with `--json`; None where it is none.

    Of `RESULTS` the one that the key `schema` names.
    """
    try:
        told = json.loads(text)
        kinds = {get_schema_name(kind): kind for kind in RESULTS}
        return from_json(kinds[told[SCHEMA_KEY]], told)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
