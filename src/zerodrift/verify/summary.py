"""What `firmware` prints and keeps in build/firmware.json, for whoever shows it later."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

from zerodrift.base.records import OPTIONAL
from zerodrift.base.shown import Shown
from zerodrift.diagnosis.data_notes import DataNote
from zerodrift.verify.header_finding import HeaderFinding
from zerodrift.verify.manifest import ManifestFinding, NotChecked

ByOutput = Mapping[str, float]
"""Output -> a value, in its unit where nothing else is said."""


@dataclass(frozen=True)
class ChipError:
    """RMS difference of integer and float model of one output, in its unit, by cause.

    The squares of the four add up to the square of the whole.
    """

    rounding: float
    out_of_range: float
    """On rows where a channel is outside its calibrated range, and on their after-effect."""
    clamped: float
    """The correction stood at its limit."""
    saturated: float
    """An operation, or a channel's code, stood at its limit."""


@dataclass(frozen=True)
class ErrorCauses:
    """Shares of a proven error, in the output's unit."""

    table: float
    """Activation tables, and the polynomials of exp2 and powers."""
    coefficients: float
    """Gains, offsets, limits and slacks, rounded to integers."""
    rounding: float
    """Results of sums, products, powers and copies, each rounded once."""
    lowpass: float
    """Low-pass filters: the rounding of every step over all time, and their coefficients."""
    weights: float
    """Weights and biases of the network."""
    output: float
    """The answer, rounded to a count."""
    conversion: float = field(default=0.0, metadata=OPTIONAL)
    """Raw codes that a table brings to the quantity."""
    range: float = field(default=0.0, metadata=OPTIONAL)
    """A network's states of which no more is shown than that they lie between -1 and 1."""


@dataclass(frozen=True, kw_only=True)
class ProvenError:
    """Proven bound on the distance of the chip's drift from that of the float model in real
    arithmetic."""

    value: float | None
    """In the output's unit; null where nothing is proven."""
    unit: str
    holds: str = field(default="", metadata=OPTIONAL)
    """Conditions under which the bound holds; empty where nothing is proven."""
    causes: ErrorCauses | None = field(default=None, metadata=OPTIONAL)
    """They add up to the value."""
    why: str = field(default="", metadata=OPTIONAL)
    """Why nothing is proven, or nothing but what the range of a network's states gives."""


@dataclass(frozen=True, kw_only=True)
class StatedUncertainty:
    """Of one output's compensated value inside the calibrated ranges, in its unit (JCGM 100)."""

    unit: str
    expanded: float
    """k = 2: twice the combined standard uncertainty, wider by Student's quantile for few runs."""
    noise: float
    """Standard uncertainty of a reading: what no compensation can take away."""
    parameters: float
    """Standard uncertainty: how far the predictions move when a run is left out."""
    left_out: float
    """Standard uncertainty: what the model lacks."""
    rounding: float
    """Standard uncertainty: the chip's integers."""
    degrees_of_freedom: float
    """From how runs differ."""
    method: str
    """leave one run out | blocks of one run: where the errors come from."""
    tared: bool
    """Whether each run's own offset is not in it."""
    covered: float | None
    """Share of the test logs' readings inside the calibrated ranges whose error is within
    `expanded`; null without test logs."""
    covered_readings: int
    """Of how many readings."""

    def explain(self) -> str:
        """Return where the figures come from, in sentences."""
        told = (
            "Standard uncertainties by cause, from models fitted to the training runs"
            f" ({self.method}); expanded: twice the root of their squares, wider for few runs."
        )
        if self.tared:
            told += " Each run's own offset is not in it, as the logs are tared."
        if self.covered is not None:
            told += " Covered: the share of the test logs' readings that lie within it."
        return told


@dataclass(frozen=True, kw_only=True)
class Statement:
    """A refusal or a warning of the gate."""

    kind: str
    """worse_than_none | worse_than_constant | worse_than_line | worse_than_physics |
    worse_than_float | worse_beyond_range | tare_decides, or a kind of wrong data, for a refusal;
    out_of_range | not_shown_better | not_judged | tare_decides for a warning."""
    output: str = field(default="", metadata=OPTIONAL)
    """The output it is about; "" where it is about runs."""
    run: str = field(default="", metadata=OPTIONAL)
    """Of wrong data: the run, ..."""
    column: str = field(default="", metadata=OPTIONAL)
    """... its column, ..."""
    rows: tuple[int, int] | None = field(default=None, metadata=OPTIONAL)
    """... and the first and last sample, from 0."""
    text: str


@dataclass(frozen=True, kw_only=True)
class LogsRefused:
    """What `train` and `firmware` print of logs that they refuse, before anything is fitted."""

    SCHEMA: ClassVar = "logs-refused/1"

    written: bool = False
    refused: tuple[Statement, ...]


def state_notes(notes: Sequence[DataNote]) -> tuple[Statement, ...]:
    """Return notes on wrong data as reasons against a firmware."""
    return tuple(
        Statement(
            kind=note.kind,
            run=note.run,
            column=note.column,
            rows=note.rows,
            text=f"run {note.run}, column {note.column}: {note.text}",
        )
        for note in notes
    )


@dataclass(frozen=True, kw_only=True)
class StageErrors:
    """RMSE against the measurements, from the bare sensor to the chip."""

    uncompensated: ByOutput
    physics: ByOutput | None = field(default=None, metadata=OPTIONAL)
    """Of the effects alone, where something was learnt beside them."""
    float: ByOutput
    integer: ByOutput
    integer_not_fine_tuned: ByOutput | None = field(default=None, metadata=OPTIONAL)


@dataclass(frozen=True)
class StackSummary:
    """The deepest stack of each function."""

    compiler: str
    flags: tuple[str, ...]
    of: Mapping[str, int]
    """Function -> bytes."""


@dataclass(frozen=True)
class NodeShare:
    """What one node of the graph adds to integer minus float."""

    node: str
    kind: str
    rms: ByOutput


@dataclass(frozen=True)
class TimeShare:
    """Integer minus float over some steps."""

    from_step: int
    to_step: int
    rms: ByOutput


@dataclass(frozen=True)
class BudgetSummary:
    """Where the error comes from: measurements, quantization, its nodes, and time."""

    float_to_measured: ByOutput
    integer_to_float: ByOutput
    nodes: tuple[NodeShare, ...]
    over_time: tuple[TimeShare, ...]


@dataclass(frozen=True)
class Claims:
    """What the certificate claims."""

    claims: int


@dataclass(frozen=True)
class ConversionSummary:
    """How the chip converts the raw codes of one input."""

    raw: str
    """uint16, int16 or int32."""
    unit: str
    covers: tuple[float, float]
    """What the table covers, in the unit; beyond it the nearest end is taken."""
    readings: tuple[int, int]
    """Raw codes beyond these are no readings; of a thermocouple, sums with its cold junction."""
    table_bytes: int
    lsb: float
    """One code of the result, in the unit."""
    error: float
    """Largest distance to the formula, rounding included, in the unit."""
    code_worth: tuple[float, float]
    """Smallest and largest step of the result per raw code, in the unit."""
    cold_junction: str | None = field(default=None, metadata=OPTIONAL)
    """The input that measures a thermocouple's cold junction."""


@dataclass(frozen=True)
class FirmwareSummary(Shown):
    """A firmware: what it needs of a chip, how it was checked, and its error stage by stage."""

    SCHEMA: ClassVar = "firmware/1"

    bit_exact: bool
    vectors: int
    """Steps that were compared."""
    backends: tuple[str, ...]
    flash_bytes: int
    ram_bytes: int
    """State of one sensor."""
    stack_bytes: int
    stack: StackSummary
    core: str
    instructions_per_step: Mapping[str, float]
    """Core -> instructions."""
    rmse: StageErrors
    bias: ByOutput
    rmse_integer_to_float: ByOutput
    error_budget: BudgetSummary
    rmse_pct_fs: ByOutput
    """Of the integer model, in % of full scale."""
    units: Mapping[str, str]
    held_out: bool
    tared: bool
    runs: tuple[str, ...]
    model_hash: str
    certificate: Claims
    gate: str
    """How the gate judged: test logs | leave one run out | blocks of one run | not judged."""
    chip_error: Mapping[str, ChipError]
    warnings: tuple[Statement, ...]
    refused: tuple[Statement, ...]
    forced: bool
    written: bool
    files: tuple[str, ...]
    explained: ByOutput | None = field(default=None, metadata=OPTIONAL)
    """1 - error² / error of a constant², of the integer model over the same runs; the constant is
    the mean drift of the training runs. Negative where the constant does better."""
    error_bound: Mapping[str, ProvenError] | None = field(default=None, metadata=OPTIONAL)
    """Output -> the proven largest distance from the float model."""
    conversions: Mapping[str, ConversionSummary] | None = field(default=None, metadata=OPTIONAL)
    """Input -> how its raw codes are converted, where the chip does."""


REFUSED = "refused.json"
"""In build/: the `Refusal` of the last firmware, where it was one."""


@dataclass(frozen=True, kw_only=True)
class Refusal:
    """Why the gate refused the last firmware, which was not written."""

    model_hash: str
    """Of the refused model; empty where the logs were refused, and nothing was fitted."""
    refused: tuple[Statement, ...]


@dataclass(frozen=True)
class CertifiedBound:
    """The range of one integer, and what its type leaves above it."""

    where: str
    low: int
    high: int
    bits: int
    headroom_bits: float


@dataclass(frozen=True)
class CertificateSummary:
    """What a certificate claims, and how close it comes to the limits."""

    model_hash: str
    bounds: int
    """How many are claimed."""
    tightest: tuple[CertifiedBound, ...]
    """Those that come closest to their limits, the closest first."""


@dataclass(frozen=True)
class VerifySummary:
    """The comparison of the firmware folder with the model."""

    SCHEMA: ClassVar = "verify/1"

    bit_exact: bool
    vectors: int
    """Steps compared on the host."""
    backends: tuple[str, ...]
    """What ran and agreed, the reference first."""
    model_hash: str
    failures: tuple[str, ...]
    """Back ends that differ, do not compile or do not run."""
    header: tuple[HeaderFinding, ...]
    """Names in the header whose values are not the model's."""
    changed: tuple[ManifestFinding, ...]
    """Files that are not as they were written."""
    stale: tuple[ManifestFinding, ...]
    """Files that would be made differently today."""
    forced: tuple[str, ...]
    """What had been found against this firmware when it was built, and was overridden."""
    not_checked: tuple[NotChecked, ...]
    claims: int
    """Claims of certificate.json that were derived again from the C and hold."""
    refuted: tuple[str, ...]
    """Claims that do not follow from the C."""
