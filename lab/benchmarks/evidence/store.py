"""Outcomes on disk: in a folder of the code's version, one case a line, so that work goes on."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

from benchmarks.evidence.conditions import Ask, Condition
from benchmarks.evidence.judge import Row, Step

ROOT = Path(__file__).resolve().parents[3]
STAGES = ("base", "dataset", "operations", "physics", "diagnosis")
JUDGED = (*(f"src/zerodrift/{stage}" for stage in STAGES), "lab/zerodrift_lab/twin")
JUDGES = tuple(f"lab/benchmarks/{name}" for name in ("third_simulator", "foreign", "hidden"))
OWN = tuple(f"lab/benchmarks/evidence/{name}.py" for name in ("conditions", "sources", "judge"))
HOME = ROOT / "build" / "evidence"


def hash_code(root: Path = ROOT) -> str:
    """Return 12 hexadecimal digits of all code that an outcome depends on."""
    found = hashlib.sha256()
    paths = [path for folder in (*JUDGED, *JUDGES) for path in sorted((root / folder).rglob("*"))]
    for path in (*paths, *(root / name for name in OWN)):
        if path.suffix in (".py", ".txt") and path.is_file():
            found.update(f"{path.relative_to(root).as_posix()}\0".encode())
            found.update(path.read_bytes())
    return found.hexdigest()[:12]


class Store:
    """Outcomes of one version of the code."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows = list(_read(path))
        self._known = {row.ask for row in self.rows}

    def __contains__(self, ask: Ask) -> bool:
        return ask in self._known

    def append(self, row: Row) -> None:
        """Keep an outcome, on disk at once."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row.to_plain()) + "\n")
        self.rows.append(row)
        self._known.add(row.ask)


def open_store(version: str | None = None) -> Store:
    """Return the outcomes of a version, by default that of the code as it is."""
    return Store(HOME / (version or hash_code()) / "outcomes.jsonl")


def _read(path: Path) -> Iterator[Row]:
    if not path.exists():
        return
    for line in path.read_text(encoding="utf-8").splitlines():
        plain = json.loads(line)
        ask = plain.pop("ask")
        logs = Condition(**ask.pop("logs"))
        ask = Ask(**{**ask, "hidden": tuple(ask["hidden"]), "logs": logs})
        plain["lookalikes"] = tuple(plain["lookalikes"])
        plain["also"] = tuple(plain.get("also", ()))
        plain["truth_errors"] = tuple(plain.get("truth_errors", ()))
        plain["steps"] = tuple(Step(**step) for step in plain["steps"])
        yield Row(ask, **plain)
