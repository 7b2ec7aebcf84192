"""What `train` prints: errors stage by stage, in the sample, on runs left out, on test logs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from zerodrift.train.compensator import Compensator
from zerodrift.train.scores import Scores, StageRmse


@dataclass(frozen=True)
class TrainingErrors:
    """RMSE of one output, in its unit; null where it was not measured."""

    rmse_uncompensated: float | None
    rmse_physics: float | None
    """Of the physical model alone."""
    rmse: float | None
    """Of the whole compensator."""
    rmse_pct_fs: float | None


@dataclass(frozen=True)
class TrainingOutput:
    """One output before and after training."""

    ALIASES: ClassVar = ("held_out",)

    unit: str
    in_sample: TrainingErrors
    left_out: TrainingErrors
    """On training runs that a second training did not see."""
    test: TrainingErrors
    """On the test logs."""

    @property
    def held_out(self) -> TrainingErrors:
        """Older name: `test`, or else `left_out`."""
        return self.test if self.test.rmse is not None else self.left_out


@dataclass(frozen=True)
class HeldOutRuns:
    """The runs that errors beside those in the sample are measured on."""

    runs: tuple[str, ...]
    explanation: str
    """In a sentence."""


@dataclass(frozen=True)
class TriedNetwork:
    """One candidate of `[network] kind = "auto"`."""

    name: str
    """Kind, and the units of one with a state."""
    rmse_left_out: Mapping[str, float] | None
    """Output -> RMSE on the training runs left out, in its unit; null where it was not trained."""
    times_best: float | None
    """Error as a multiple of the best one's, mean over the outputs."""
    instructions: int | None
    """Of a step on the core; null where no compiler or emulator is installed."""
    flash_bytes: int | None
    products: int | None
    """Multiplications of a step."""
    as_good: bool
    """Whether the error is within 5 % of the best."""
    why: str
    """Why it was not trained; that its network found nothing and was left out; or nothing."""


@dataclass(frozen=True)
class NetworkChoice:
    """The networks that `[network] kind = "auto"` tried, and its choice."""

    taken: str
    tried: tuple[TriedNetwork, ...]
    units: Mapping[str, str]
    """Output -> its unit."""
    core: str
    explanation: str
    """Which runs were left out."""


@dataclass(frozen=True)
class TrainingSummary:
    """What training achieved."""

    outputs: Mapping[str, TrainingOutput]
    held_out: HeldOutRuns
    effects: tuple[str, ...]
    features: tuple[str, ...]
    """What the network sees."""
    network: bool
    """Whether a network stayed in the compensator; one that is not worth its flash is left out."""
    notes: tuple[str, ...]


def summarise_training(compensator: Compensator, scores: Scores) -> TrainingSummary:
    """Return what training achieved, as plain values."""
    front_end = compensator.front_end
    return TrainingSummary(
        outputs={name: _summarise_output(scores, k) for k, name in enumerate(scores.outputs)},
        held_out=HeldOutRuns(tuple(scores.held_out_runs), scores.explanation),
        effects=tuple(compensator.physics.effects),
        features=tuple(str(tap) for tap in front_end.taps) if front_end else (),
        network=compensator.network is not None,
        notes=tuple(compensator.notes),
    )


def _summarise_output(scores: Scores, k: int) -> TrainingOutput:
    nothing = TrainingErrors(None, None, None, None)
    held_out = _list_errors(scores.held_out, k, scores.full_scale[k])
    return TrainingOutput(
        unit=scores.units[k],
        in_sample=_list_errors(scores.in_sample, k, scores.full_scale[k]),
        left_out=nothing if scores.on_test_logs else held_out,
        test=held_out if scores.on_test_logs else nothing,
    )


def _list_errors(errors: StageRmse, k: int, full_scale: float) -> TrainingErrors:
    def read(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    return TrainingErrors(
        rmse_uncompensated=read(errors.uncompensated[k]),
        rmse_physics=read(errors.physics[k]),
        rmse=read(errors.compensated[k]),
        rmse_pct_fs=read(100.0 * errors.compensated[k] / full_scale),
    )
