"""A fleet of simulated sensors: time per sensor, and batched GRUs against one at a time.

The sensors are those of `zerodrift twin`, one seed each: two chamber runs to train on and one to
test, an hour at 1 Hz, six outputs, told zero_tempco, dark_current and thermal_lag, written in
absolute force (not tared). That is about 1 MB of CSV per sensor. Simulating them is not timed.

    python -m benchmarks.bench_fleet [--quick] [--sensors N] [--jobs N] [--training | --blocks]

Processor time is that of all processes, their start and imports included; its share per core is
what the wall clock shows on a machine that does nothing else.
"""

import argparse
import json
import multiprocessing
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.fleet.sensors import configure_sensor, find_sensors
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.train.attempts import Problem
from zerodrift.train.engine import Result, train_networks
from zerodrift.train.network_training import pose_validation
from zerodrift.train.prepare import Task, prepare, read_settings
from zerodrift_lab.twin import EffectChoice, Recipe, simulate
from zerodrift_lab.twin.logs import render_config, render_logs

TOLD = ("zero_tempco", "dark_current", "thermal_lag")
SENSORS, QUICK_SENSORS = 1024, 24
LIMIT_S, CORES, LEAST_RATIO = 120.0, 2, 5.0
BLOCKS_S = 70.0
FIRMWARE, IN_BLOCK = "[firmware]\n", 'coefficients = "block"\n'
TABLE = '\n[fleet]\nfolder = "fleet/{sensor}"\n'
GRUS, QUICK_GRUS, REPEATS = 64, 16, 3
"""Sensors trained together, and how often both ways are timed in turn."""


def main(
    quick: bool,
    sensors: int | None = None,
    jobs: int = CORES,
    training: bool = False,
    blocks: bool = False,
) -> None:
    """Print time per sensor with and without C, of a rerun, and the ratio of batched training.

    Args:
        quick: fewer sensors.
        sensors: how many.
        jobs: processes.
        training: the ratio alone.
        blocks: one program and a block per sensor, and what they take on the disk; no training.
    """
    count = sensors or (QUICK_SENSORS if quick else SENSORS)
    with tempfile.TemporaryDirectory(prefix="bench-fleet-") as folder:
        project = Path(folder)
        size = write_fleet(project, count, jobs)
        if blocks:
            write_blocks(project, count, jobs, judge=not quick and sensors is None)
            return
        print(f"{count} simulated sensors, {size / 1e6:.0f} MB of CSV, physical model, {jobs} jobs")
        for name, options in (
            ("without C", ("--no-firmware",)),
            ("with checked C", ()),
            ("again, nothing changed", ()),
        )[: 0 if training else None]:
            report = time_fleet(project, jobs, *options)
            print(describe(name, count, report, judge=not quick and sensors is None))
        compare_training(project, QUICK_GRUS if quick else min(GRUS, count))


def write_blocks(project: Path, count: int, jobs: int, *, judge: bool) -> None:
    """Print time and disk of a fleet of one program and a block per sensor."""
    toml = project / "zerodrift.toml"
    text = toml.read_text(encoding="utf-8")
    toml.write_text(text.replace(FIRMWARE, FIRMWARE + IN_BLOCK), encoding="utf-8")
    subprocess.run(
        [sys.executable, "-m", "zerodrift", "registry", "init", "-C", str(project)],
        capture_output=True,
        check=True,
    )
    for name in ("one program, blocks", "again, nothing changed"):
        report = time_fleet(project, jobs)
        print(describe(name, count, report, judge=judge, limit_s=BLOCKS_S), flush=True)
    for line in explain_failures(project, report):
        print(line)
    for name in ("fleet", "build", "firmware"):
        files = [path for path in (project / name).rglob("*") if path.is_file()]
        size = sum(path.stat().st_size for path in files)
        print(f"{name}/: {size / count / 1e3:.1f} kB and {len(files) / count:.1f} files per sensor")
    size = sum(path.stat().st_size for path in project.glob("registry.sqlite*"))
    print(f"registry: {size / count / 1e3:.2f} kB per sensor")


def explain_failures(project: Path, report: dict[str, Any]) -> list[str]:
    """Return a line per sensor that does not pass: how hot its logs are, and the first reason."""
    config = load_config(project)
    lines = []
    for result in report["results"]:
        if result["status"] == "pass":
            continue
        dataset = load_dataset(configure_sensor(config, result["sensor"]))
        trained, tested = (
            max(float(run.temperature_degC.max()) for run in runs)
            for runs in (dataset.train, dataset.test)
        )
        lines.append(
            f"{result['sensor']}: trained up to {trained:.1f} degC, tested up to {tested:.1f} degC;"
            f" {result['status']}: {result['reasons'][0]}"
        )
    return lines


def write_fleet(project: Path, count: int, jobs: int) -> int:
    """Write the logs and zerodrift.toml of a fleet; return the logs' size in bytes."""
    tasks = [(project, seed) for seed in range(count)]
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        sizes = pool.map(_write_sensor, tasks, chunksize=8)
    text = render_config(simulate(make_recipe(0)))
    (project / "zerodrift.toml").write_text(text.replace('"logs/', '"') + TABLE)
    return sum(sizes)


def make_recipe(seed: int) -> Recipe:
    """Return what a sensor's logs are simulated from."""
    return Recipe(
        seed=seed,
        train=("chamber",) * 2,
        test=("chamber",),
        dwell=False,
        channels=(),
        told=tuple(EffectChoice(name) for name in TOLD),
        tare="none",
    )


def _write_sensor(task: tuple[Path, int]) -> int:
    project, seed = task
    folder = project / "fleet" / f"SN{seed:04d}"
    folder.mkdir(parents=True)
    logs = render_logs(simulate(make_recipe(seed)))
    for name, content in logs.items():
        (folder / Path(name).name).write_bytes(content)
    return sum(map(len, logs.values()))


def time_fleet(project: Path, jobs: int, *options: str) -> dict[str, Any]:
    """Return wall and processor time of `zerodrift fleet`, and what it reported."""
    before, start = _children_s(), time.perf_counter()
    command = [sys.executable, "-m", "zerodrift", "fleet", "-C", str(project), "--json"]
    done = subprocess.run(
        [*command, "--jobs", str(jobs), *options], capture_output=True, text=True, check=False
    )
    wall_s, cpu_s = time.perf_counter() - start, _children_s() - before
    if done.returncode not in (0, 1) or not done.stdout:
        raise SystemExit(done.stderr)
    report = json.loads(done.stdout)
    steps = sum(r.get("vectors", 0) for r in report["results"])  # with blocks those of the program
    return {**report, "wall_s": wall_s, "cpu_s": cpu_s, "steps": steps}


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def describe(
    name: str, count: int, report: dict[str, Any], *, judge: bool, limit_s: float = LIMIT_S
) -> str:
    """Return a line of the result."""
    per_core_s = report["cpu_s"] / CORES
    verdict = ""
    if judge:
        verdict = f" ({'within' if per_core_s <= limit_s else 'BEYOND'} {limit_s:.0f} s)"
    steps = f", {report['steps'] / 1e6:.1f} million steps equal" if report["steps"] else ""
    return (
        f"{name:24s} processor {report['cpu_s']:7.1f} s, a core's share of {CORES}"
        f" {per_core_s:6.1f} s{verdict}, wall {report['wall_s']:6.1f} s on this machine as loaded,"
        f" {1e3 * report['cpu_s'] / count:.0f} ms per sensor; {report['passed']:.0f} pass{steps}"
    )


def compare_training(project: Path, count: int) -> None:
    """Print the processor time of GRU(8) per sensor, one at a time and all at once."""
    problems = pose_problems(project, count)
    ratios, alone_s, together_s = [], [], []
    for _ in range(REPEATS):
        start = time.process_time()
        alone = [train_networks([problem])[0] for problem in problems[: max(4, count // 8)]]
        middle = time.process_time()
        together = train_networks(problems)
        alone_s.append((middle - start) / len(alone))
        together_s.append((time.process_time() - middle) / count)
        ratios.append(alone_s[-1] / together_s[-1])
        differences = [
            abs(a.rmse / b.rmse - 1.0)
            for a, b in zip(alone, together, strict=False)
            if isinstance(a, Result) and isinstance(b, Result)
        ]
    ratio = statistics.median(ratios)
    print(
        f"GRU(8), 2 starts of 80 epochs, processor time per sensor: one at a time"
        f" {statistics.median(alone_s):.2f} s, {count} at once {statistics.median(together_s):.3f}"
        f" s: {ratio:.1f} x ({'reached' if ratio >= LEAST_RATIO else 'MISSED'} {LEAST_RATIO:.0f} x;"
        f" runs {min(ratios):.1f} to {max(ratios):.1f}); best held-out error differs by at most"
        f" {max(differences):.1e} of itself"
    )


def pose_problems(project: Path, count: int) -> list[Problem]:
    """Return the rehearsals of GRU(8) on what zero_tempco alone leaves of the first sensors."""
    config = load_config(project)
    network = replace(config.network, kind="gru", hidden=8)
    effects = tuple(e for e in config.effects if e.kind == "zero_tempco")
    config = replace(config, network=network, effects=effects)
    catalogue = load_catalogue()
    problems = []
    for sensor in find_sensors(config)[:count]:
        own = configure_sensor(config, sensor)
        dataset, settings = load_dataset(own), read_settings(own.network)
        task = Task(own, dataset, settings, prepare(own, dataset, settings, catalogue))
        problems.append(pose_validation(task))
    return problems


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bench_fleet", description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--sensors", type=int, default=None)
    parser.add_argument("--jobs", type=int, default=CORES)
    parser.add_argument("--training", action="store_true", help="the ratio of training alone")
    parser.add_argument("--blocks", action="store_true", help="one program, a block per sensor")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.sensors, arguments.jobs, arguments.training, arguments.blocks)
