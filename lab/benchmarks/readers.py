"""Readers of one long log, each in a process of its own, taking turns: seconds and peak memory."""

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

POLARS = "polars"
"""The reader that the others are held against."""


@dataclass(frozen=True)
class Reading:
    """What one reader took."""

    reader: str
    steps: int
    seconds: float
    memory: float
    """Peak beyond what the process held after its imports, over the columns' size as float64."""


@dataclass(frozen=True)
class Limits:
    """What the readers may take, as multiples of Polars' time and of the columns' size."""

    time: float
    memory: float


def run_here(module: str, *arguments: str | Path) -> str:
    """Run a benchmark's module in a fresh process and return what it printed.

    A child's peak memory is never told as less than its parent's, so that files are written by one.
    """
    command = [sys.executable, "-m", module, *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def take_turns(module: str, readers: Sequence[str], repeats: int, directory: Path) -> list[Reading]:
    """Return every reading, the readers taking turns."""
    turns = list(readers) * repeats
    return [Reading(**json.loads(run_here(module, name, directory))) for name in turns]


def measure(reader: str, read: Callable[[], int], values_per_step: float) -> str:
    """Return as JSON what a reader takes in this process.

    Args:
        reader: its name.
        read: reads the log and returns its steps.
        values_per_step: numbers of the log for each of them.
    """
    held = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start_s = time.perf_counter()
    steps = read()
    seconds = time.perf_counter() - start_s
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - held
    share = peak * 1024 / (8 * steps * values_per_step)
    return json.dumps(asdict(Reading(reader, steps, seconds, share)))


def print_table(readings: Sequence[Reading], limits: Limits, judge: bool) -> None:
    """Print a line per reader, and whether the limits, which are for long logs, are kept.

    Times are the least of the repeats, memory the most.
    """
    names = list(dict.fromkeys(one.reader for one in readings))
    own = {name: [one for one in readings if one.reader == name] for name in names}
    least = {name: min(one.seconds for one in found) for name, found in own.items()}
    most = {name: max(one.memory for one in found) for name, found in own.items()}
    print(f"{'reader':<11}{'steps':>10}{'seconds':>10}{'x Polars':>10}{'peak x data':>13}")
    good = True
    for name in names:
        ratio = least[name] / least[POLARS]
        steps = own[name][0].steps
        print(f"{name:<11}{steps:>10}{least[name]:>10.2f}{ratio:>10.2f}{most[name]:>13.2f}")
        good &= ratio <= limits.time and (most[name] <= limits.memory or name == POLARS)
    if judge:
        verdict = "met" if good else "MISSED"
        print(f"limits: {limits.time:g} x Polars, {limits.memory:g} x data: {verdict}")
