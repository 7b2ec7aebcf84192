"""What `[logs]` selects: files by glob, runs by `#name`, a part of each run by `@from:to`."""

import fnmatch
import glob
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, locate_key
from zerodrift.base.errors import InputError, nearest
from zerodrift.base.fleet_config import URL
from zerodrift.dataset.formats.registry import list_formats

CSV_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc")
PARQUET_SUFFIXES = (".parquet", ".pq")
ARROW_SUFFIXES = (".feather", ".arrow", ".ipc")
JOINT = " + "
"""Between files that are one log."""


def list_suffixes() -> tuple[str, ...]:
    """Return what the names of logs end in: text, Parquet, Arrow, and what is read by libraries."""
    return (*CSV_SUFFIXES, *PARQUET_SUFFIXES, *ARROW_SUFFIXES, *list_formats())


_CUT = re.compile(r"^(?P<rest>.+)@(?P<start>[^@#/]*):(?P<stop>[^@#/]*)$")
_RUN = re.compile(r"^(?P<rest>.+?)#(?P<run>[^#/]+)$")
_BOUND = re.compile(r"^(?P<number>\d+(\.\d*)?)(?P<percent>%?)$")


@dataclass(frozen=True)
class CutEnd:
    """One end of a cut: seconds since the run's first row, or a share of its duration."""

    value: float
    """Seconds, or a share 0..1."""
    is_share: bool

    def to_seconds(self, duration_s: float) -> float:
        """Return this end in seconds since the first row of a run of `duration_s`."""
        return self.value * duration_s if self.is_share else self.value


@dataclass(frozen=True)
class Cut:
    """A part of each run, from `start` up to but not including `stop`; None = to its end."""

    text: str
    """As written, for the run's name: `0%:60%`."""
    start: CutEnd
    stop: CutEnd | None

    def to_span(self, duration_s: float) -> tuple[float, float]:
        """Return the cut's two ends in seconds since the first row; the last may be infinite."""
        start_s = self.start.to_seconds(duration_s)
        if self.stop is None or (self.stop.is_share and self.stop.value >= 1):
            return start_s, np.inf
        return start_s, self.stop.to_seconds(duration_s)

    def find_rows(self, time_s: Array) -> slice:
        """Return the rows of a run (rising `time_s`) that the cut keeps."""
        start_s, stop_s = self.to_span(float(time_s[-1] - time_s[0]))
        first, last = np.searchsorted(time_s - time_s[0], (start_s, stop_s), side="left")
        return slice(int(first), int(last))


@dataclass(frozen=True)
class Selection:
    """One log that `[logs]` selects, and which part of it."""

    path: Path
    """The file, or the folder whose files are joined; of a list of files, the first."""
    files: tuple[Path, ...]
    """All of its files, joined on time where there are several."""
    run_pattern: str | None
    """Pattern for the value of the `run` column; None = every run, and files without one."""
    cut: Cut | None
    where: str
    """Place in zerodrift.toml, for messages."""

    def accepts(self, run: str) -> bool:
        """Tell whether the run of this name is selected."""
        return self.run_pattern is None or fnmatch.fnmatchcase(run, self.run_pattern)


def expand_selectors(config: Config, use: str) -> tuple[Selection, ...]:
    """Return the files that `[logs] use` selects, sorted by name whatever the selectors' order.

    Args:
        config: the project.
        use: "train", "test" or "dwell".

    Raises:
        InputError: a selector is malformed, matches no file, or matches a file that is no log.
    """
    selectors: tuple[str, ...] = getattr(config, f"{use}_logs")
    where = locate_key(config.path, "logs", use)
    found = [
        selection
        for text in selectors
        for selection in _expand_selector(config.directory, text, f"{where}: [logs] {use}")
    ]
    return tuple(sorted(found, key=lambda each: order_path(each.path, config.directory)))


def matches_logs(config: Config, log: Path) -> bool:
    """Return whether [logs] train or test selects a file, by itself or within a folder.

    Raises:
        InputError: a selector is malformed, or matches a file that is no log.
    """
    place = log.resolve()
    single = [("train", replace(config, train_logs=(one,))) for one in config.train_logs]
    single += [("test", replace(config, test_logs=(one,))) for one in config.test_logs]
    for use, part in single:
        try:
            found = expand_selectors(part, use)
        except NoLogsError:  # the first log of its kind is still to come
            continue
        if any(place == file.resolve() for one in found for file in one.files):
            return True
    return False


def order_path(path: Path, directory: Path) -> tuple[str, ...]:
    """Return the sort key of a log: its path relative to the project."""
    return Path(os.path.relpath(path, directory)).parts


def _expand_selector(directory: Path, text: str, where: str) -> list[Selection]:
    pattern, run_pattern, cut = text, None, None
    # A file whose own name holds '#' or '@' is meant literally.
    if not (directory / text).is_file():
        if match := _CUT.match(pattern):
            pattern = match["rest"]
            cut = _parse_cut(match["start"], match["stop"], text, where)
        elif "@" in Path(pattern).name and not _glob(directory, pattern):
            raise _explain_cut(text, where)
        if match := _RUN.match(pattern):
            pattern, run_pattern = match["rest"], match["run"]
    if JOINT in pattern and not _glob(directory, pattern):
        files = [_find_part(directory, part.strip(), where) for part in pattern.split(JOINT)]
        return [Selection(files[0], tuple(files), run_pattern, cut, where)]
    paths = _glob(directory, pattern)
    if not paths:
        raise NoLogsError(_explain_no_match(directory, pattern, where))
    _refuse_lost(directory, pattern, text, paths, where)
    selections = []
    for path in paths:
        files = list_files(path)
        if not files:
            raise InputError(f"{where}: '{text}' selects {path.name}, a folder without logs.")
        if path.is_file() and path.suffix.lower() not in list_suffixes():
            raise InputError(
                f"{where}: '{text}' selects {path.name}; expected logs that end in "
                f"{', '.join(list_suffixes())}. Narrow the glob."
            )
        selections.append(Selection(path, tuple(files), run_pattern, cut, where))
    return selections


def list_files(path: Path) -> list[Path]:
    """Return a log's files, sorted by name: those of a folder that could be logs, or the one."""
    if not path.is_dir():
        return [path]
    found = sorted(each for each in path.iterdir() if each.suffix.lower() in list_suffixes())
    # The files of a rosbag2 folder are read together, by its metadata.yaml.
    bags = [each for each in found if each.suffix.lower() == ".db3"]
    return [each for each in found if each not in bags[1:]]


def _find_part(directory: Path, name: str, where: str) -> Path:
    if (directory / name).is_file():
        return directory / name
    raise NoLogsError(_explain_no_match(directory, name, where))


def _refuse_lost(directory: Path, pattern: str, text: str, paths: list[Path], where: str) -> None:
    """Refuse a glob that matches files, and a folder too, of which nothing would be read.

    Raises:
        InputError: names the folder.
    """
    if all(path.is_dir() for path in paths):
        return
    taken = {file.parent for file in paths}
    for path in _match(directory, pattern):
        is_log = path.suffix.lower() in list_suffixes() or bool(path.is_dir() and list_files(path))
        if path.is_dir() and is_log and not any(p == path or path in p.parents for p in taken):
            raise InputError(
                f"{where}: '{text}' selects files and the folder {path}, of which nothing would be"
                " read; expected files alone, or folders alone, each of which is a run. Narrow the"
                " glob; if the folder is a run, name it by itself too."
            )


def _match(directory: Path, pattern: str) -> list[Path]:
    """Return everything that matches, sorted by name."""
    # Path.glob refuses `..` and absolute patterns, which logs outside of the project need.
    names = glob.glob(pattern, root_dir=directory, recursive=True)  # noqa: PTH207
    return [directory / name for name in sorted(names)]


def _glob(directory: Path, pattern: str) -> list[Path]:
    """Return the files that match, or else the folders with logs, sorted by name.

    A plain name is never read as a pattern.
    """
    if (directory / pattern).is_file():
        return [directory / pattern]
    found = _match(directory, pattern)
    files = [path for path in found if not path.is_dir()]
    return files or [path for path in found if list_files(path)]


def _parse_cut(start: str, stop: str, text: str, where: str) -> Cut:
    first = _parse_bound(start, text, where) if start else CutEnd(0.0, False)
    last = _parse_bound(stop, text, where) if stop else None
    alike = last is not None and (last.is_share == first.is_share or first.value == 0)
    if last is not None and alike and last.value <= first.value:
        raise InputError(
            f"{where}: '{text}' ends where it begins or before; expected FROM < TO after the '@'."
        )
    return Cut(f"{start}:{stop}", first, last)


def _parse_bound(bound: str, text: str, where: str) -> CutEnd:
    match = _BOUND.match(bound)
    if match is None or (match["percent"] and float(match["number"]) > 100):
        raise _explain_cut(text, where)
    number = float(match["number"])
    return CutEnd(number / 100, True) if match["percent"] else CutEnd(number, False)


def _explain_cut(text: str, where: str) -> InputError:
    return InputError(
        f"{where}: '{text}' has no readable cut after the '@'; expected @FROM:TO in seconds since "
        "the run's first row, as @0:3600, or in percent of its duration, as @0%:60%."
    )


class NoLogsError(InputError):
    """A selector that no file matches."""


def _explain_no_match(directory: Path, pattern: str, where: str) -> str:
    if URL in pattern:
        return (
            f"{where}: '{pattern}' is a URL, by which `zerodrift fleet` alone reads logs; expected"
            " a path. Copy the logs to this machine and name them by their path."
        )
    folder = (directory / pattern).parent
    known = sorted(path.name for path in folder.glob("*") if path.is_file())
    logs = [name for name in known if Path(name).suffix in list_suffixes()]
    if glob.has_magic(str(folder)):
        found = "nothing does."
    elif not folder.is_dir():
        found = f"there is no directory {folder}."
    elif logs:
        shown = ", ".join(logs[:8]) + (", ..." if len(logs) > 8 else "")
        found = f"{folder} holds {shown}{nearest(Path(pattern).name, logs) or '.'}"
    else:
        found = f"{folder} holds no CSV or Parquet file."
    remedy = f"correct the glob, which is relative to {directory}."
    if (directory / "twin.json").is_file():
        remedy = f"`zerodrift twin --example -C {directory}` simulates them from twin.json."
    return f"{where}: no file matches '{pattern}': {found} Expected at least one log; {remedy}"
