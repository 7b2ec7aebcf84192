"""CPU time, wall time and memory of the loop's commands on long logs, and where the time goes.

Simulated logs of six outputs with a thermal lag that the model does not know:

- 11 runs of 35 000 rows at 10 Hz: `diagnose` over the whole catalogue and `compare`;
- 8 runs, together an hour, at three rates up to 1 kHz (3.6 million rows): whether time grows in
  proportion to the rows, and the peak of memory.

Each command runs as a whole process: imports, reading the CSV and printing included. The limits are
for CPU time, which on an idle core is no less than what the wall clock says; on a busy machine the
wall clock says more about the others. The split by stage is taken by wrapping the stages' functions
in a further process.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMMANDS = ("diagnose", "compare")
CPU_S = {"diagnose": 10.0, "compare": 10.0}
"""Limits for 11 runs of 35 000 rows."""
HOUR_CPU_S = 60.0
HOUR_PEAK_GB = 4.0
"""Limits of `diagnose` for an hour at 1 kHz."""
LINEAR = 1.1
"""Largest exponent of CPU time over rows that counts as linear."""
STAGES = {
    "read": ("zerodrift.tasks.project", "open_project"),
    "base": ("zerodrift.diagnosis.examination", "fit_base"),
    "noise": ("zerodrift.diagnosis.examination", "measure_rest"),
    "candidates": ("zerodrift.diagnosis.examination", "try_candidates"),
    "judge": ("zerodrift.diagnosis.examination", "_judge"),
    "diagnose": ("zerodrift.diagnosis.diagnose", "diagnose"),
    "fit": ("zerodrift.physics.fit", "fit_config"),
    "hold out": ("zerodrift.diagnosis.held_out", "hold_out"),
    "floor": ("zerodrift.diagnosis.compare", "measure_floor"),
    "failures": ("zerodrift.diagnosis.compare", "find_failures"),
    "compare": ("zerodrift.diagnosis.compare", "compare"),
}
"""Stage -> the function whose time it is. `noise` is within `base` too, and told once."""


@dataclass(frozen=True)
class Logs:
    """A simulated project."""

    name: str
    runs: int
    rows: int
    """Of each run."""
    period_s: float

    @property
    def total(self) -> int:
        """Rows of all runs."""
        return self.runs * self.rows


@dataclass(frozen=True)
class Cost:
    """What a process took."""

    cpu_s: float
    wall_s: float
    peak_gb: float


TYPICAL = Logs("11 runs at 10 Hz", 11, 35_000, 0.1)
QUICK = Logs("11 runs at 10 Hz, a tenth of the rows", 11, 3_500, 0.1)
HOUR = tuple(
    Logs(f"8 runs, an hour, at {1 / period_s:.0f} Hz", 8, round(450 / period_s), period_s)
    for period_s in (0.01, 0.003, 0.001)
)


def main(quick: bool) -> None:
    """Print the table of costs and the split by stage; `quick` takes short logs and no limits."""
    with tempfile.TemporaryDirectory() as folder:
        costs: dict[tuple[str, str], Cost] = {}
        print(
            f"{'simulated logs':<40}{'rows':>10}{'command':>10}{'CPU s':>8}{'wall s':>8}{'GB':>7}"
        )
        for number, logs in enumerate((QUICK,) if quick else (TYPICAL, *HOUR)):
            directory = Path(folder) / str(number)
            write_project(directory, logs)
            for command in COMMANDS:
                cost = run_process("-m", "zerodrift", command, "-C", str(directory), "--json")
                costs[logs.name, command] = cost
                print(
                    f"{logs.name:<40}{logs.total:>10}{command:>10}{cost.cpu_s:>8.1f}"
                    f"{cost.wall_s:>8.1f}{cost.peak_gb:>7.2f}",
                    flush=True,
                )
            if logs in (QUICK, TYPICAL, HOUR[-1]):
                for command in COMMANDS:
                    print(f"  CPU s within {command}: {split_stages(directory, command)}")
        if not quick:
            print_limits(costs)


def print_limits(costs: dict[tuple[str, str], Cost]) -> None:
    """Print whether the limits are kept, and the exponents of time over rows."""

    def say(what: str, found: float, limit: float) -> None:
        print(f"{what}: {found:.2f}, limit {limit:g}: {'met' if found <= limit else 'MISSED'}")

    for command in COMMANDS:
        cost = costs[TYPICAL.name, command]
        say(f"{TYPICAL.name}, {command}, CPU s", cost.cpu_s, CPU_S[command])
    hour = costs[HOUR[-1].name, "diagnose"]
    say("an hour at 1 kHz, diagnose, CPU s", hour.cpu_s, HOUR_CPU_S)
    say("an hour at 1 kHz, diagnose, peak GB", hour.peak_gb, HOUR_PEAK_GB)
    for command in COMMANDS:
        small, large = (costs[logs.name, command].cpu_s for logs in (HOUR[0], HOUR[-1]))
        exponent = math.log(large / small) / math.log(HOUR[-1].total / HOUR[0].total)
        say(f"CPU time of {command} as a power of the rows", exponent, LINEAR)


def write_project(directory: Path, logs: Logs) -> None:
    """Write simulated logs and a zerodrift.toml that does not know of the lag."""
    duration_s = logs.rows * logs.period_s
    # In a process of its own: a child's peak memory is never told as less than its parent's.
    run_process(
        *("-m", "zerodrift", "twin", "-C", str(directory), "--json", "--seed", "5"),
        *("--runs", str(logs.runs), "--test", "none", "--hidden", "thermal_lag", "--size", "3"),
        *("--period", str(logs.period_s), "--duration", str(duration_s)),
        *(() if logs.period_s > 0.05 else ("--no-dwell",)),
    )


def run_process(*arguments: str) -> Cost:
    """Run Python with these arguments; return what it took."""
    start_s = time.perf_counter()
    with tempfile.TemporaryFile("w+") as errors:
        command = [sys.executable, *arguments]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            errors.seek(0)
            raise RuntimeError(f"{' '.join(arguments)}: {errors.read()}")
    wall_s = time.perf_counter() - start_s
    return Cost(usage.ru_utime + usage.ru_stime, wall_s, usage.ru_maxrss * 1024 / 1e9)


def split_stages(directory: Path, command: str) -> str:
    """Return the CPU seconds of each stage of a command, in words."""
    arguments = [sys.executable, __file__, command, str(directory)]
    done = subprocess.run(arguments, check=True, capture_output=True, text=True)
    return str(json.loads(done.stdout.splitlines()[-1])["words"])


def measure_stages(command: str, directory: Path) -> str:
    """Run a command in this process with its stages' functions wrapped; return the words."""
    import importlib

    from click.testing import CliRunner

    spent: dict[str, float] = dict.fromkeys(STAGES, 0.0)
    running: list[str] = []

    def wrap(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **named: Any) -> Any:
            start_s = time.process_time()
            running.append(stage)
            try:
                return function(*arguments, **named)
            finally:
                running.pop()
                took_s = time.process_time() - start_s
                spent[stage] += took_s
                if running:
                    # What a stage within a stage took is its own alone.
                    spent[running[-1]] -= took_s

        return timed

    for stage, (module_name, name) in STAGES.items():
        module = importlib.import_module(module_name)
        setattr(module, name, wrap(stage, getattr(module, name)))
    from zerodrift.cli.main import cli

    before_s = time.process_time()
    done = CliRunner().invoke(cli, [command, "-C", str(directory), "--json"])
    if done.exception is not None:
        raise done.exception
    whole_s = time.process_time() - before_s
    names = {stage: took for stage, took in spent.items() if took > 0.0}
    names["imports"] = before_s
    names["rest"] = whole_s - sum(spent.values())
    return ", ".join(f"{stage} {took:.2f}" for stage, took in names.items())


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print(json.dumps({"words": measure_stages(sys.argv[1], Path(sys.argv[2]))}))
    else:
        main("--quick" in sys.argv[1:])
