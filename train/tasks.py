"""What the training of networks is given, one task per sensor, and what comes of it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.config import Config
from zerodrift.base.progress import Stage
from zerodrift.dataset.runs import Dataset
from zerodrift.train.prepare import Prepared
from zerodrift.train.scores import Trained
from zerodrift.train.settings import Settings

VALIDATION, FINAL, LEFT_OUT = "rehearsal.npz", "performance.npz", "left_out.npz"
FREE = "free.npz"
"""Checkpoints in build/; the third stays when it is complete: the next `firmware` takes it."""
UNFORESEEN = (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError)
"""What one sensor's numbers might raise that nobody thought of; the others go on."""
Answer = Trained | Exception
Report = Callable[[Stage], None]


@dataclass(frozen=True)
class Task:
    """One sensor whose network is to be trained."""

    config: Config
    dataset: Dataset
    settings: Settings
    prepared: Prepared


@dataclass(frozen=True)
class Handling:
    """What the training of networks is told beside the tasks."""

    device: str = "cpu"
    """"cpu" or "cuda"."""
    folder: Path | None = None
    """Where checkpoints are kept; None = nowhere."""
    resume: bool = True
    """Take up an interrupted training of these very inputs."""
    report: Report = lambda _: None
    """Called after each epoch."""
