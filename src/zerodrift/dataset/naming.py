"""Names of runs: the shortest that are unique; and no row both learnt from and tested on."""

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from zerodrift.base.errors import InputError


@dataclass(frozen=True)
class RunKey:
    """What a run is: a file, a value of its `run` column, a part in time."""

    path: Path
    run: str
    """Value of the `run` column; empty for a file without one."""
    cut: str
    """As written after the '@'; empty for the whole run."""
    span_s: tuple[float, float]
    """The part in seconds since the run's first row, the second end not included."""
    where: str
    """Place in zerodrift.toml, for messages."""
    start_s: float = 0.0
    """The log's clock at the run's first row in s, before any cut."""
    place: int = 0
    """Position of the run among those of its file, in the order of appearance."""
    files: tuple[Path, ...] = ()
    """All files of the log, where `path` is a folder or the first of several."""

    def name(self, detail: int, directory: Path) -> str:
        """Return a name: by run or stem (0), by stem and run (1), by path and run (2)."""
        # What follows a point in a folder's name is part of it.
        file = self.path.name if self.path.is_dir() else self.path.stem
        if detail == 2:
            inside = self.path.is_relative_to(directory)
            path = self.path.relative_to(directory) if inside else self.path
            file = str(path)
        base = self.run if self.run and detail == 0 else f"{file}:{self.run}" if self.run else file
        return f"{base}@{self.cut}" if self.cut else base


def name_runs(keys: Sequence[RunKey], directory: Path) -> dict[RunKey, str]:
    """Return a unique name for every run, with more detail only where names would collide."""
    distinct = {(key.path, key.run, key.cut): key for key in keys}
    names: dict[tuple[Path, str, str], str] = {}
    left = dict(distinct)
    for detail in (0, 1, 2):
        candidates = {identity: key.name(detail, directory) for identity, key in left.items()}
        counts = Counter(candidates.values())
        for identity, name in candidates.items():
            if (counts[name] == 1 and name not in names.values()) or detail == 2:
                names[identity] = name
                del left[identity]
    return {key: names[key.path, key.run, key.cut] for key in keys}


def refuse_overlaps(keys: Sequence[RunKey]) -> None:
    """Raise InputError when two selectors of train and test share rows.

    Args:
        keys: one per selector and run.

    A row that is both learnt from and tested on makes the held-out error too small; one that is
    selected twice counts double.
    """
    by_run: dict[tuple[Path, str], list[RunKey]] = {}
    for key in keys:
        by_run.setdefault((key.path.resolve(), key.run), []).append(key)
    for same in by_run.values():
        for one, other in itertools.combinations(same, 2):
            if max(one.span_s[0], other.span_s[0]) < min(one.span_s[1], other.span_s[1]):
                run = f", run '{one.run}'" if one.run else ""
                raise InputError(
                    f"{other.where}: selects rows of {other.path.name}{run} that {one.where} "
                    "selects already; expected every row once, as a row both learnt from and "
                    "tested on makes the held-out error too small. Narrow one glob, or cut the "
                    "run: '@0%:60%' and '@60%:100%'."
                )
