"""How a network is trained."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """How a network is trained; `docs/explanation/training.md` says where the numbers come from."""

    memory: str | int = "stream"
    """"stream", or the window's length in samples."""
    seed: int = 0
    starts: tuple[int, ...] = (0, 1)
    """Which first weights to try; each number stands for its own draw."""
    epochs: int = 80
    """Length of the learning-rate cycle."""
    learning_rate: float = 2e-2
    """Peak of the one cycle."""
    weight_decay: float = 0.1
    """Per step and unit of learning rate, on weights but not on biases."""
    chunk: int = 32
    """Samples over which a stream is differentiated."""
    batch: int = 128
    """Chunks in a step of the optimiser; of windows, as many as hold that many samples."""
    warm_up: float = 0.25
    """Share of the steps in which the learning rate rises."""
    evaluations: int = 10
    """How often per start the held-out runs are looked at and the checkpoint is written."""


@dataclass(frozen=True)
class Tuning:
    """How the fine-tuning is done."""

    epochs: int = 24
    learning_rate: float = 2e-4
    """Peak of the one cycle; a row's step at 8 bits is 1/127 of its largest weight."""
    warm_up: float = 0.1
    chunk: int = 32
    """Samples over which a stream is differentiated."""
    batch: int = 64
    """Chunks in a step of the optimiser."""
    evaluations: int = 12
    """How often all runs are walked through from their start and the best weights are kept."""
    seed: int = 0
