"""Opens a project for a command: example logs, configuration, dataset, trained compensator."""

from pathlib import Path
from typing import TYPE_CHECKING

from zerodrift.config import Config, load_config
from zerodrift.dataset.runs import Dataset

if TYPE_CHECKING:
    from rich.console import Console

    from zerodrift.train.compensator import Compensator


def open_project(directory: Path, skip_invalid: bool = False) -> tuple[Config, Dataset]:
    """Return a project's configuration and logs; a bundled example's logs are simulated first.

    Raises:
        InputError: zerodrift.toml or a log is missing or wrong.
    """
    from zerodrift.dataset.load import load_dataset
    from zerodrift.physics.twin.example import ensure_example_logs

    ensure_example_logs(directory)
    config = load_config(directory)
    return config, load_dataset(config, skip_invalid)


def train_project(config: Config, dataset: Dataset, console: "Console") -> "Compensator":
    """Return the project's trained compensator, trained now unless build/ has it already."""
    raise NotImplementedError
