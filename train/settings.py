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
