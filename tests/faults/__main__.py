"""Fault injection: `python -m tests.faults [--share 0.1] [SCENARIO ...]`.

Runs every command that writes, with its n-th call of open, write, rename, fsync, mkdir, unlink and
their like on the project's paths failing (EIO, ENOSPC, EMFILE), and with the process killed there
(SIGKILL): for every n, or a share of them. Then --drawn calls on other paths fail, and as many
allocations of more than 64 KiB. After each: one message and exit code 2, or success; each set of
files old or new, at once or after the next command; the command done again works and leaves no
stray. Prints points tried, tracebacks, wrong exit codes, mixed sets and strays, with every case.
Exit code 1 if there is one.
"""

import argparse
import importlib
import math
import os
import random
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from tests.faults.points import ALLOCATION, ELSEWHERE, FAIL, KILL, ON_PROJECT, Point, Trial
from tests.faults.scenarios import SCENARIOS
from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.cli.main import list_commands

HERE = Path(__file__).parent
MODULES = ("numpy", "polars", "scipy.optimize", "zerodrift.verify.firmware")


def main() -> None:
    """Preload the shim, load the commands, and try all points."""
    names = [scenario.name for scenario in SCENARIOS]
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help=", ".join(names))
    parser.add_argument("--share", type=float, default=1.0, help="of the points on project paths")
    parser.add_argument("--drawn", type=int, default=200, help="other calls, and allocations, each")
    parser.add_argument("--seconds", type=float, help="of processor time, about, for all of them")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if "ZD_FAULTS" not in os.environ:
        sys.exit(preload())
    load_modules()
    wanted = [s for s in SCENARIOS if not given.scenarios or s.name in given.scenarios]
    rng = random.Random(given.seed)
    total: Counter[str] = Counter()
    drawn = math.ceil(given.drawn * given.share / len(SCENARIOS))
    with tempfile.TemporaryDirectory(prefix="zd-faults-") as folder:
        for number, scenario in enumerate(wanted):
            trial = Trial(scenario, Path(folder).resolve() / scenario.name)
            used = tell_seconds()
            left = (given.seconds or math.inf) - used
            trial.prepare()
            points = draw_points(trial, given.share, drawn, rng)
            total += try_points(trial, points, used + left / (len(wanted) - number))
    print(
        f"faults: {total['points']} points tried, {total['traceback']} tracebacks,"
        f" {total['exit code']} wrong exit codes, {total['message']} without one message,"
        f" {total['mixed']} mixed sets, {total['stray']} strays, {total['next command']} where the"
        f" next command fails, {total['hang']} hangs"
    )
    sys.exit(any(count for kind, count in total.items() if kind != "points"))


def preload() -> int:
    """Build the shim and run this program again under it."""
    with tempfile.TemporaryDirectory() as name:
        shim = build_shim(Path(name))
        environment = {**os.environ, "LD_PRELOAD": str(shim), "ZD_FAULTS": "1"}
        command = [sys.executable, "-m", "tests.faults", *sys.argv[1:]]
        return subprocess.run(command, env=environment, check=False).returncode


def build_shim(folder: Path) -> Path:
    """Compile what is preloaded."""
    shim = folder / "shim.so"
    source = str(HERE / "shim.c")
    find_compiler().run(["-O1", "-w", "-shared", "-fPIC", source, "-o", str(shim), "-ldl"])
    return shim


def load_modules() -> None:
    """Import what the commands need, once for all children."""
    commands = list_commands()
    for name in {scenario.arguments[0] for scenario in SCENARIOS}:
        importlib.import_module(commands[name][1].partition(":")[0])
    for name in MODULES:
        importlib.import_module(name)


def tell_seconds() -> float:
    """Return the processor time of all children so far, theirs included."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def draw_points(trial: Trial, share: float, drawn: int, rng: random.Random) -> list[Point]:
    """Return a share of the points on the project, and as many others, in drawn order."""
    points = [
        Point(ON_PROJECT, way, number)
        for way in (FAIL, KILL)
        for number in range(1, len(trial.calls[ON_PROJECT]) + 1)
    ]
    count = max(round(share * len(points)), 1)
    points = rng.sample(points, count)
    for where in (ELSEWHERE, ALLOCATION):
        calls = len(trial.calls[where])
        numbers = rng.sample(range(1, calls + 1), min(drawn, calls))
        points += [Point(where, FAIL, number) for number in numbers]
    return rng.sample(points, len(points))


def try_points(trial: Trial, points: list[Point], until: float) -> Counter[str]:
    """Try points, at least one, until that much processor time is used; print what is wrong.

    Returns the counts.
    """
    total: Counter[str] = Counter()
    places = ("", " elsewhere", " allocation")
    for point in points:
        if total and tell_seconds() > until:
            break
        if total["points"] % 50 == 49:
            done = f"{trial.scenario.name}: {total['points']} of {len(points)} points"
            print(done, file=sys.stderr, flush=True)
        told = trial.try_point(point)
        total["points"] += 1
        for kind in {kind for kind, _ in told.wrong}:
            total[kind] += 1
        for kind, detail in told.wrong:
            way = "killed at" if point.way == KILL else "fails"
            print(
                f"{trial.scenario.name}{places[point.where]} {way} {point.number}"
                f" ({told.call[:90]}): {kind}: {detail[-260:]}",
                flush=True,
            )
    print(
        f"{trial.scenario.name}: {total['points']} of {2 * len(trial.calls[ON_PROJECT])} points and"
        f" {len(trial.calls[ELSEWHERE])} + {len(trial.calls[ALLOCATION])} other calls; "
        + (", ".join(f"{n} {k}" for k, n in total.items() if k != "points") or "all well"),
        flush=True,
    )
    return total


if __name__ == "__main__":
    main()
