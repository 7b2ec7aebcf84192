"""The result of one sensor of a fleet: its errors, and the file that keeps it."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

from zerodrift.base.errors import InputError
from zerodrift.base.files import show_path
from zerodrift.base.journal import write_all
from zerodrift.base.records import MEASURED, from_json, read_sealed, render_sealed, to_dict
from zerodrift.export.integer_model import IntegerModel

# The result of one sensor of a fleet, and the file that keeps it.

FORMAT = 4
"""Of result.json; another one is computed anew."""
RESULT = "result.json"


@dataclass(frozen=True)
class OutputResult:
    """Root mean square errors of one output, in its unit."""

    ALIASES: ClassVar = ("ratio",)

    unit: str
    rmse_uncompensated: float = field(metadata=MEASURED)
    rmse: float = field(metadata=MEASURED)
    """Held out, of the float model."""
    rmse_integer: float | None = field(metadata=MEASURED)
    """The same of the firmware's integer model; None without firmware or without test logs."""
    noise_floor: float = field(metadata=MEASURED)
    chip_error: Mapping[str, float] | None = field(default=None, metadata=MEASURED)
    """RMS of integer minus float model by cause: rounding, out_of_range, clamped, saturated."""

    @property
    def judged(self) -> float:
        """The error that limits apply to: the firmware's where there is one."""
        return self.rmse if self.rmse_integer is None else self.rmse_integer

    @property
    def ratio(self) -> float:
        """The judged error over the noise floor; infinite over a floor of zero."""
        if self.noise_floor > 0.0:
            return self.judged / self.noise_floor
        return math.inf if self.judged > 0.0 else 1.0


@dataclass(frozen=True)
class ParameterResult:
    """A fitted value of one sensor, which those of the other sensors are compared with."""

    value: float = field(metadata=MEASURED)
    std_error: float = field(metadata=MEASURED)
    unit: str
    is_log: bool = False
    """Whether sensors are compared by its logarithm."""


@dataclass(frozen=True)
class SensorResult:
    """One sensor that went through."""

    sensor: str
    mark: str
    """Of the design and of this sensor's logs; the same mark need not be computed again."""
    held_out: str
    """What the errors were measured on, in a sentence."""
    floor: str
    """Where the noise floor comes from: dwell | estimated."""
    outputs: Mapping[str, OutputResult]
    parameters: Mapping[str, ParameterResult]
    """Parameters of effects as `thermal_lag.tau_s`, coefficients as `Fz dark_current`."""
    temperature_degC: tuple[float, float]
    network: bool
    """Whether a network stayed in the compensator."""
    notes: tuple[str, ...]
    vectors: int = 0
    """Steps at which the C was equal to the reference; 0 without firmware."""
    model_hash: str = ""
    refused: tuple[str, ...] = ()
    """Why the gate refused the firmware; also where it was forced."""
    forced: bool = False
    """Whether it was written nevertheless."""
    warnings: tuple[str, ...] = ()
    """What else the gate says: runs beyond the calibrated ranges, what was not judged."""
    program: str = ""
    """With blocks: the identity of the program with which it was tried; empty before that."""
    block: str = ""
    """With blocks: SHA-256 of its block; empty where it has none."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Files written, relative to the project -> SHA-256."""


@dataclass(frozen=True)
class TriedBlock:
    """What became of a unit in the one program of a fleet."""

    content: bytes = b""
    """Its block; empty where there is none."""
    why_none: str = ""
    """In what it does not fit the program's design."""


@dataclass(frozen=True)
class SensorOutcome:
    """The result of one sensor, or why there is none."""

    sensor: str
    result: SensorResult | None
    error: str = ""
    """Why there is no result."""
    kept: bool = False
    """Whether an earlier run had done it."""
    tried: TriedBlock | None = None
    """With blocks, once it was tried in the one program."""
    model: IntegerModel | None = None
    """With blocks, what this run has written as its integer model."""


def save_result(
    folder: Path, project: Path, result: SensorResult, files: Mapping[Path, bytes | None]
) -> SensorResult:
    """Write a sensor's files and result.json as one change; return the result with their hashes.

    The disk is not waited for: what a power failure leaves does not have the hash that result.json
    names, or is no result.json, and the sensor is computed anew.

    Args:
        folder: the sensor's own folder below build/.
        project: the folder of zerodrift.toml, which the names in the result are relative to; held
            by the command whose worker this is.
        result: what to write; the files that it names already stay named.
        files: the sensor's other files.

    Raises:
        InputError: they cannot be written; the old ones are as they were.
    """
    hashes = {
        show_path(path, project): hashlib.sha256(content).hexdigest()
        for path, content in files.items()
        if content is not None
    }
    whole = replace(result, files={**result.files, **hashes})
    contents = {**files, folder / RESULT: render_sealed({"format": FORMAT, **to_dict(whole)})}
    write_all(project, contents, durable=False, under_lock=True)
    return whole


def load_result(folder: Path, project: Path, mark: str) -> SensorResult | None:
    """Return the kept result if it is of this mark and its files are as they were written.

    A file that is damaged or of another version is not an error: the sensor is computed anew.
    """
    try:
        result = read_result((folder / RESULT).read_bytes())
        whole = all(hash_file(project / name) == h for name, h in result.files.items())
    except (InputError, OSError, ValueError):
        return None
    return result if whole and result.mark == mark else None


def read_result(content: bytes) -> SensorResult:
    """Return what result.json holds.

    Raises:
        ValueError: it is damaged, or of another format.
    """
    body = read_sealed(content)
    if body.pop("format", None) != FORMAT:
        raise ValueError(f"expected format {FORMAT}")
    return from_json(SensorResult, body)


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        InputError: it cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
