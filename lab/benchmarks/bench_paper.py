"""The default method against the paper's, on the six-axis twin: errors, times, sizes.

All data are simulated. Errors are pooled over the six axes, each in shares of its drift's RMS over
the chamber cycles; figures are medians over specimens and seeds, with quartiles. Specimens 1 to 3
served to choose the default; the others are looked at here alone. "bench" is heating, cooling and
the plates of the walk without strides, together. Varied logs are twelve of these protocols and of
two more, in draws of their own; "no plates" are twelve of which none stands on the plates. The
paper's GRU is trained in two ways on all specimens, by one learning-rate cycle of 40 epochs and by
L-BFGS on whitened taps with the head solved; each line on errors takes whichever of the two did
better on its very tests. By the paper's own recipe (2000 epochs at a constant rate) it is trained
on the first specimen as far as `--recipe-epochs` goes.

No method's error gets below the noise of the test, so the paper's GRU over the noise floor is the
most that any method can gain on it. Beside each ratio of errors stands that of the drift's errors,
noise taken off.

Every fit is kept in `--store`, so that an interrupted benchmark goes on where it was.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift_lab.paper.plan import DEFAULT, PAPER_GRU, PROJECTED_GRU
from zerodrift_lab.paper.store import Cell, Store
from zerodrift_lab.paper.study import Outcome, run_study
from zerodrift_lab.paper.summary import Outcomes, Spread, summarise
from zerodrift_lab.twin.project import name_outputs
from zerodrift_lab.twin.six_axis import draw_sensor, load_protocol, record
from zerodrift_lab.twin.six_axis.project import render_config

BENCH = ("heating", "cooling", "walking_still")
LOADED = ("chamber_loaded", "walking")
SENSORS, SEEDS = 8, 3
RECIPE_EPOCHS = 2000
STORE = Path("build/bench_paper")
CSV_MB = 38.0
GRUS = {"gru": PAPER_GRU, "projected": PROJECTED_GRU}
"""The paper's GRU, by way of training."""
BODY_OF = {"varied": "body", "unwalked": "unwalked body"}
"""Fits with the second thermometer, by those without."""


@dataclass(frozen=True)
class Row:
    """One line of the benchmark."""

    what: str
    target: str
    measured: Spread
    reached: bool | None
    """None: a figure without a target."""

    def write(self) -> str:
        """Return the line."""
        verdict = {True: "reached", False: "NOT reached", None: "for comparison"}[self.reached]
        spread = self.measured
        quartiles = f"{spread.low:.3g} to {spread.high:.3g}, {spread.count} values"
        return f"{self.what:<66} {self.target:>9} {spread.median:9.3g}   {verdict} ({quartiles})"


def main(quick: bool) -> None:
    """Print the table; `quick` is one specimen, one seed, a few epochs of the recipe."""
    run(1 if quick else SENSORS, 1 if quick else SEEDS, 5 if quick else RECIPE_EPOCHS, STORE, quick)


def list_cells(sensors: int, seeds: int, recipe_epochs: int, rows: str) -> dict[str, list[Cell]]:
    """Return the fits by group, for all rows or for those of one kind."""
    specimens, starts = range(1, sensors + 1), range(seeds)
    everyone = [(s, start) for start in starts for s in specimens]
    cells = {
        "linear": [Cell("lsm_linear", s) for s in specimens],
        "chamber": [Cell(DEFAULT, s, start) for s, start in everyone],
        "varied": [Cell(DEFAULT, s, start, logs="varied") for s, start in everyone],
        "body": [Cell(DEFAULT, s, start, logs="varied", body=True) for s, start in everyone],
        "loaded": [Cell(DEFAULT, s, start, logs="loaded") for s, start in everyone],
        "loaded body": [Cell(DEFAULT, s, start, logs="loaded", body=True) for s, start in everyone],
        "unwalked": [Cell(DEFAULT, s, start, logs="unwalked") for s, start in everyone],
        "unwalked body": [
            Cell(DEFAULT, s, start, logs="unwalked", body=True) for s, start in everyone
        ],
        **{
            f"{name} {logs}": [Cell(method, s, start, logs=logs) for s, start in everyone]
            for name, method in GRUS.items()
            for logs in ("chamber", "varied", "unwalked")
        },
        "recipe": [
            Cell(PAPER_GRU, 1, schedule="recipe", epochs=recipe_epochs, course=True),
            Cell(PAPER_GRU, 1, course=True),
            Cell(PROJECTED_GRU, 1, course=True),
        ],
    }
    left_out = () if rows == "all" else ("loaded", "loaded body", "recipe")
    return {name: group for name, group in cells.items() if name not in left_out}


def run(
    sensors: int, seeds: int, recipe_epochs: int, store: Path, quick: bool, rows: str = "all"
) -> None:
    """Print the table for so many specimens and seeds."""
    cells = list_cells(sensors, seeds, recipe_epochs, rows)

    def tell(done: int, total: int, what: str) -> None:
        print(f"  {done} of {total} fits: {what}", file=sys.stderr, flush=True)

    found = run_study([cell for group in cells.values() for cell in group], Store(store), say=tell)
    outcomes = Outcomes(found)
    groups = {name: outcomes.get(group) for name, group in cells.items()}
    print(
        f"simulated; specimens 1 to {sensors}, {seeds} seed(s); medians (quartiles)\n"
        f"{'what':<66} {'target':>9} {'measured':>9}"
    )
    for row in [*compare_errors(groups, outcomes), *compare_sizes(groups)]:
        print(row.write())
    if rows == "all":
        print_time(groups, recipe_epochs)
    print_floors(groups)
    if rows != "all":
        return
    measure_csv(2.0 if quick else CSV_MB)
    print("fleet: python -m benchmarks.bench_fleet")


def pool(outcome: Outcome, tests: Sequence[str]) -> float:
    """Return the error of several tests together, in shares of the chamber's drift."""
    squares = [np.mean((outcome.rmse(test) / outcome.scale()) ** 2) for test in tests]
    return float(np.sqrt(np.mean(squares)))


def pool_floor(outcome: Outcome, tests: Sequence[str]) -> float:
    """Return the noise floor of several tests together, likewise."""
    squares = [np.mean((outcome.floor(test) / outcome.scale()) ** 2) for test in tests]
    return float(np.sqrt(np.mean(squares)))


def pool_drift(outcome: Outcome, tests: Sequence[str]) -> float:
    """Return `pool` with the noise of the tests taken off, in squares.

    The noise is the same whatever the method; what is left is the method's error of the drift.
    """
    squared = pool(outcome, tests) ** 2 - pool_floor(outcome, tests) ** 2
    return float(np.sqrt(max(squared, 1e-300)))


def divide(
    outcomes: Outcomes,
    ways: Sequence[Sequence[Outcome]],
    others: Sequence[Outcome],
    tests: Sequence[str],
    error: Callable[[Outcome, Sequence[str]], float] = pool,
) -> Spread:
    """Return the errors of a method over those of others, paired by specimen and seed.

    Args:
        outcomes: all there are.
        ways: of the method, by each way of training; the best of each pair counts.
        others: what it is compared with.
        tests: pooled.
        error: how.
    """
    pairs = [outcomes.pair(ones, others) for ones in ways]
    return summarise(
        min(error(one, tests) for one, _ in alike) / error(alike[0][1], tests)
        for alike in zip(*pairs, strict=True)
    )


def over_floor(tests: Sequence[str], *ways: Sequence[Outcome]) -> Spread:
    """Return errors over the noise floor, the best of several ways of training."""
    return summarise(
        min(pool(o, tests) for o in alike) / pool_floor(alike[0], tests)
        for alike in zip(*ways, strict=True)
    )


def compare_errors(groups: dict[str, list[Outcome]], outcomes: Outcomes) -> list[Row]:
    """Return the lines on errors."""
    chamber = ("chamber",)
    rows: list[Row] = []

    def more(what: str, spread: Spread, least: float) -> None:
        rows.append(Row(what, f">= {least:g}", spread, spread.median >= least))

    def less(what: str, spread: Spread, most: float) -> None:
        rows.append(Row(what, f"<= {most:g}", spread, spread.median <= most))

    def tell(what: str, spread: Spread) -> None:
        rows.append(Row(what, "", spread, None))

    g = groups
    grus = {
        logs: [g[f"{name} {logs}"] for name in GRUS] for logs in ("chamber", "varied", "unwalked")
    }
    more(
        "chamber, held-out cycles: LSM linear / default",
        divide(outcomes, [g["linear"]], g["chamber"], chamber),
        40.0,
    )
    less("chamber, held-out cycles: default / floor", over_floor(chamber, g["chamber"]), 1.12)
    more(
        "bench, chamber logs only: the paper's GRU / default",
        divide(outcomes, grus["chamber"], g["chamber"], BENCH),
        1.0,
    )
    more(
        "bench, varied logs: the paper's GRU / default",
        divide(outcomes, grus["varied"], g["varied"], BENCH),
        2.5,
    )
    more(
        "bench, varied logs, second thermometer: the paper's GRU / default",
        divide(outcomes, grus["varied"], g["body"], BENCH),
        5.0,
    )
    less(
        "bench, varied logs, second thermometer: default / floor",
        over_floor(BENCH, g["body"]),
        1.15,
    )
    for logs, what in (("varied", "varied logs"), ("unwalked", "no plates")):
        tell(f"bench, {what}: the paper's GRU / floor", over_floor(BENCH, *grus[logs]))
        for name, second in ((logs, ""), (BODY_OF[logs], ", second thermometer")):
            label = f"bench, {what}{second}"
            tell(f"{label}: default / floor", over_floor(BENCH, g[name]))
            one_cycle = [g[f"gru {logs}"]]
            tell(f"{label}: GRU / default", divide(outcomes, grus[logs], g[name], BENCH))
            tell(
                f"{label}: GRU by one cycle / default",
                divide(outcomes, one_cycle, g[name], BENCH),
            )
            tell(
                f"{label}: GRU / default, noise taken off",
                divide(outcomes, grus[logs], g[name], BENCH, pool_drift),
            )
    for name, what in (("loaded", "load"), ("loaded body", "load, second thermometer")):
        for test in LOADED if name in g else ():
            less(f"{what}, {test}: default / floor", over_floor((test,), g[name]), 2.0)
    return rows


def compare_sizes(groups: dict[str, list[Outcome]]) -> list[Row]:
    """Return the lines on parameters and multiplications, of the larger default."""
    rows = []
    for key, what, target in (("parameters", "parameters", 15.0), ("macs_per_step", "MACs", 100.0)):
        for name, logs in (
            ("chamber", "chamber"),
            ("varied", "varied"),
            ("body", "two thermometers'"),
        ):
            theirs = groups["gru chamber"][0].result[key]
            spread = summarise(theirs / o.result[key] for o in groups[name])
            label = f"{what}, {logs} logs: the paper's GRU window / default"
            rows.append(Row(label, f">= {target:g}", spread, spread.median >= target))
    return rows


def print_time(groups: dict[str, list[Outcome]], epochs: int) -> None:
    """Print what the recipe's final error costs by each way, on specimen 1."""
    recipe, *quicker = groups["recipe"]
    course = [(point["cpu_s"], _read(point, recipe)) for point in recipe.result["course"]]
    seconds, error = course[-1]
    whole_s = seconds / epochs * RECIPE_EPOCHS
    ours = groups["chamber"][0]
    told = f"measured over {epochs} epochs"
    if epochs < RECIPE_EPOCHS:
        told += f"; {RECIPE_EPOCHS} epochs extrapolated from the time of one to {whole_s:.0f} s"
    print("time to the recipe's final error, held-out chamber of specimen 1, CPU seconds")
    print(f"  recipe: {100.0 * error:.3g} % of the drift after {seconds:.0f} s ({told})")
    own = pool(ours, ("chamber",))
    for way, outcome in zip(("one cycle", "whitened, head solved"), quicker, strict=True):
        reached = [
            point["cpu_s"] for point in outcome.result["course"] if _read(point, outcome) <= error
        ]
        end = 100.0 * pool(outcome, ("chamber",))
        if reached:
            told = (
                f"there after {reached[0]:.3g} s, 1/{seconds / reached[0]:.0f} of the time "
                f"measured, 1/{whole_s / reached[0]:.0f} of 2000 epochs (target 1/50); ends at"
                f" {end:.3g} % after {outcome.result['fit_cpu_s']:.3g} s"
            )
        else:
            told = f"not there; ends at {end:.3g} % after {outcome.result['fit_cpu_s']:.3g} s"
        print(f"  the same GRU, {way}: {told}")
    cost = ours.result["fit_cpu_s"]
    print(
        f"  default: {100.0 * own:.3g} % after {cost:.3g} s, search included: "
        f"{'there' if own <= error else 'NOT there'}, 1/{seconds / cost:.0f} of the time measured, "
        f"1/{whole_s / cost:.0f} of 2000 epochs (target 1/1000)"
    )


def _read(point: dict[str, dict[str, dict[str, list[float]]]], outcome: Outcome) -> float:
    rmse = np.array(point["tests"]["chamber"]["rmse"])
    return float(np.sqrt(np.mean((rmse / outcome.scale()) ** 2)))


def print_floors(groups: dict[str, list[Outcome]]) -> None:
    """Print every group's error over the noise floor, test by test."""
    print("error / noise floor, medians")
    tests = ("chamber", *BENCH, *LOADED)
    print("  " + " " * 18 + "".join(f"{test:>15}" for test in tests))
    for name, group in groups.items():
        if name == "recipe":
            continue
        figures = "".join(f"{over_floor((test,), group).median:15.2f}" for test in tests)
        print(f"  {name:<18}{figures}")


def measure_csv(megabytes: float) -> None:
    """Print the CPU time from CSV to a verified header, search of the lags included."""
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch)
        (project / "logs").mkdir()
        sensor, runs, written = draw_sensor(1), [], 0
        kinds = ("chamber", "chamber", "standing", "heating", "cooling", "lamp_steps")
        while written < megabytes * 1e6:
            kind = kinds[len(runs) % len(kinds)]
            name = f"{kind}_{len(runs) + 1}"
            log = record(sensor, load_protocol(kind), name=name, seed=1, period_s=0.1)
            names = name_outputs()
            table = np.column_stack([log.time_s, log.temperature_degC, log.measured, log.reference])
            head = ",".join(["time_s", "temperature_degC", *names, *(f"ref_{n}" for n in names)])
            path = project / "logs" / f"{name}.csv"
            np.savetxt(path, table, fmt="%.7g", delimiter=",", header=head, comments="")
            written += path.stat().st_size
            runs.append(log)
        text = render_config(runs).replace("sample_period_s = 0.1", "sample_period_s = 1.0")
        text = text.replace('kind = "none"', 'kind = "lag_bank"').replace("hidden = 16\n", "")
        text = text.replace('memory = "stream"\n', "")
        (project / "zerodrift.toml").write_text(text)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "zerodrift", "firmware", "-C", str(project)]
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(
            f"{written / 1e6:.1f} MB of CSV to a verified header, search included: {seconds:.1f} "
            f"CPU s, exit code {done.returncode} (target for {CSV_MB:g} MB: 30 s)"
        )
        if done.returncode:
            print(done.stderr[-1500:])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The default against the paper's methods.")
    parser.add_argument("--quick", action="store_true", help="one specimen, one seed")
    parser.add_argument("--sensors", type=int, default=0, help="specimens (8)")
    parser.add_argument("--seeds", type=int, default=0, help="seeds (3)")
    parser.add_argument("--recipe-epochs", type=int, default=0, help="of the recipe (2000)")
    parser.add_argument(
        "--rows", choices=("all", "bench"), default="all", help="bench: heat and sizes alone"
    )
    parser.add_argument("--store", type=Path, default=STORE, help="where fits are kept")
    given = parser.parse_args()
    run(
        given.sensors or (1 if given.quick else SENSORS),
        given.seeds or (1 if given.quick else SEEDS),
        given.recipe_epochs or (5 if given.quick else RECIPE_EPOCHS),
        given.store,
        given.quick,
        given.rows,
    )
