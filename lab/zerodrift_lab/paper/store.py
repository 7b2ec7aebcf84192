"""Results of single fits, each kept under the hash of all that decides it.

A study that was interrupted takes up what is kept. The hash covers the numbers of the simulated
logs and the source of the method, so that nothing outdated is ever shown.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from zerodrift.base.errors import InputError
from zerodrift.train.checkpoint import write_whole
from zerodrift_lab.paper.world import digest_logs

FORMAT = 1
DATA = (
    "zerodrift/dataset/runs.py",
    "zerodrift_lab/twin",
    "zerodrift_lab/paper/world.py",
    "zerodrift_lab/paper/walking_still.txt",
)
NETWORK = (
    "zerodrift_lab/methods/interface.py",
    "zerodrift_lab/methods/windows.py",
    "zerodrift_lab/methods/networks.py",
    "zerodrift/train/networks.py",
    "zerodrift/train/engine.py",
    "zerodrift/train/recurrence.py",
)
PHYSICS = tuple(
    f"zerodrift/physics/{name}.py"
    for name in (
        "campaign", "catalogue", "effect", "effects_element", "effects_input", "effects_load",
        "effects_temperature", "effects_time", "fit", "live", "model",
        "reduction", "search", "signals", "terms",
    )
)  # fmt: skip
OFFSETS = "zerodrift/diagnosis/case.py"
SOURCES: Mapping[str, tuple[str, ...]] = {
    "linear": (
        "zerodrift_lab/methods/interface.py",
        "zerodrift_lab/methods/windows.py",
        "zerodrift_lab/methods/linear.py",
    ),
    "network": NETWORK,
    "gru_window_projected": (*NETWORK, "zerodrift_lab/methods/projected.py"),
    "baseline": ("zerodrift_lab/methods/windows.py", "zerodrift_lab/methods/baselines.py"),
    "physics": ("zerodrift/operations", *PHYSICS, OFFSETS, "zerodrift/train"),
}
"""Family of methods, or one method -> the files, or folders of them, that decide its results."""


@dataclass(frozen=True)
class Cell:
    """One fit: everything that decides its result."""

    method: str
    sensor: int
    seed: int = 0
    logs: str = "chamber"
    """chamber | varied | unwalked | loaded."""
    body: bool = False
    """Whether the method may see the second thermometer."""
    spacing_s: float = 10.0
    """Between the samples of a window."""
    schedule: str = "quick"
    epochs: int = 0
    effects: tuple[str, ...] = ()
    """Empty: the method's own, or those of `study.EFFECTS`."""
    course: bool = False
    """Whether the error is kept along the epochs too."""


@cache
def digest_sources(family: str) -> str:
    """Return the hash of the code that decides a family's results."""
    digest = hashlib.sha256()
    for name in SOURCES[family]:
        package, _, inner = name.partition("/")
        _digest(resources.files(package).joinpath(inner), name, digest)
    return digest.hexdigest()


def _digest(node: Traversable, name: str, digest: "hashlib._Hash") -> None:
    if node.is_dir():
        for child in sorted(node.iterdir(), key=lambda child: child.name):
            if child.is_dir() or child.name.endswith(".py"):
                _digest(child, f"{name}/{child.name}", digest)
        return
    digest.update(name.encode() + b"\0" + node.read_bytes() + b"\0")


class Store:
    """A folder of results, one JSON file each.

    Args:
        directory: made when the first result is kept.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def find_path(self, cell: Cell, family: str) -> Path:
        """Return where a result lies or would lie."""
        logs = digest_logs(cell.sensor, cell.logs, cell.body)
        sources = digest_sources(cell.method if cell.method in SOURCES else family)
        key = json.dumps([FORMAT, asdict(cell), logs, sources], sort_keys=True)
        return self.directory / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.json"

    def load(self, cell: Cell, family: str) -> dict[str, Any] | None:
        """Return a kept result; None where there is none, or where the file is damaged."""
        try:
            kept = json.loads(self.find_path(cell, family).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            return None
        except OSError as error:
            raise InputError(
                f"{self.directory}: kept results cannot be read ({error.strerror}); expected "
                "files that this user may read. Name another place by --out."
            ) from error
        return kept if isinstance(kept, dict) and "tests" in kept else None

    def save(self, cell: Cell, family: str, result: Mapping[str, Any]) -> None:
        """Keep a result; the file is there whole or not at all."""
        text = json.dumps({"cell": asdict(cell), **result}, indent=1, allow_nan=False)
        write_whole(self.find_path(cell, family), text.encode())
