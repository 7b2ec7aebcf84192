"""What the gate says of wrong firmware, case by case, of clean simulated projects, and of firmware
that many unseen runs show to be worse than a baseline."""

import math
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from tests.gate.sensors import TESTS, TRAIN, Program, ask_gate, heat, write_sensor

from zerodrift.base.errors import InputError
from zerodrift.verify.gate import GateVerdict
from zerodrift_lab.twin import EffectChoice, Recipe, simulate, write_logs

CASES: dict[str, tuple[Sequence[Program], dict[str, float]]] = {
    "as it should be": ((*TRAIN, *TESTS), {}),
    "220 to 380 degC": (
        tuple(heat(program) for program in (*TRAIN, *TESTS)),
        {"span_degC": 80.0},
    ),
    "a test log in kelvin": (
        (*TRAIN, *TESTS[:2], replace(TESTS[2], logged_add=273.15)),
        {},
    ),
    "a test log 12 K beyond training": (
        (*TRAIN, *TESTS[:2], replace(TESTS[2], high_degC=52.0)),
        {},
    ),
    "a training run in thousandths": (
        (*TRAIN[:3], replace(TRAIN[3], logged_times=1000.0), *TESTS),
        {},
    ),
    "full_scale 10^6 too large": ((*TRAIN, *TESTS), {"full_scale": 1e7}),
}
"""Runs and what is wrong, all simulated."""
CLEAN = 50
WANDERING = 60
UNSEEN = 40
"""Test runs by which it is settled whether a firmware is worse than a baseline."""
QUICK = 3
MORE = 4
"""Times the test runs by which a refusal of a clean project is examined again: the same training
logs, more runs of the same sensor."""
KINDS = ("chamber", "heating", "cooling", "walking")
HIDDEN = ("thermal_lag", "span_tempco", "creep", "warm_up")
CONFIDENCE = 0.95


def main(quick: bool) -> None:
    """Print each case's verdict, then how many of the clean projects are refused."""
    for name, (programs, options) in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            try:
                verdict = ask_gate(write_sensor(Path(folder), programs, **options))  # type: ignore[arg-type]
            except InputError as error:
                print(f"{name} (simulated): refused when it is read: {error}")
                continue
        (split,) = verdict.chip_error
        causes = ", ".join(f"{cause} {x:.2g}" for cause, x in asdict(split).items())
        print(f"{name} (simulated): {describe(verdict)}; integer minus float in bar: {causes}")
    weigh_wandering(QUICK if quick else WANDERING)
    count, refused, warned = QUICK if quick else CLEAN, 0, 0
    for seed in range(count):
        recipe = draw_recipe(seed)
        verdict = judge_recipe(recipe)
        refused += not verdict.passes
        warned += any(warning.kind == "out_of_range" for warning in verdict.warnings)
        if not verdict.passes:
            print(f"clean project {seed} ({recipe.network}): {describe(verdict)}")
            for statement in verdict.refused:
                print(f"    {statement.text}")
            if recipe.test:
                more = replace(recipe, test=recipe.test * MORE)
                print(f"    with {MORE} times the test runs: {describe(judge_recipe(more))}")
    bound = bound_rate(refused, count)
    print(
        f"clean projects (simulated twin): {refused} of {count} refused (rate below"
        f" {100.0 * bound:.2g} % with {100 * CONFIDENCE:g} %); {warned} told of runs beyond the"
        " calibrated ranges"
    )


def weigh_wandering(count: int) -> None:
    """Print what is said of firmware that learnt from a random drift, by how it does unseen.

    The sensors drift by up to 0.5 bar with temperature, and by an RMS of 0.02 to 10 bar at random;
    two to four runs are for training, one to five for the gate. A firmware is worse where 40 more
    runs refuse it.
    """
    told: dict[str, list[str]] = {"worse": [], "not worse": []}
    for seed in range(count):
        rng = np.random.default_rng([seed, 7])
        options = {"wander": float(np.exp(rng.uniform(np.log(0.02), np.log(10.0))))}
        network = str(rng.choice(["none", "lag_bank"]))
        train = TRAIN[: int(rng.integers(2, 5))]
        tests = [
            Program(f"test_{k:02}", *rng.uniform([10.0, 28.0], [22.0, 40.0]))
            for k in range(UNSEEN + 5)
        ]
        few = int(rng.integers(1, 6))
        verdicts = []
        for own in (tests[:few], tests[5:]):
            with tempfile.TemporaryDirectory() as folder:
                project = write_sensor(
                    Path(folder),
                    (*train, *own),
                    network=network,
                    seed=seed,
                    full_scale=100.0,
                    **options,
                )
                verdicts.append(ask_gate(project))
        first, settled = verdicts
        is_worse = any(r.kind.startswith("worse_than") for r in settled.refused)
        what = "stopped" if not first.passes else "told" if first.warnings else "silent"
        told["worse" if is_worse else "not worse"].append(what)
        if is_worse and what == "silent":
            print(f"wandering {seed}: {few} test runs, silent; unseen: {describe(settled)}")
    for name, found in told.items():
        parts = ", ".join(f"{found.count(x)} {x}" for x in ("stopped", "told", "silent"))
        print(
            f"wandering sensors (simulated), {name} on {UNSEEN} unseen runs: {len(found)}: {parts}"
        )


def judge_recipe(recipe: Recipe) -> GateVerdict:
    """Return the verdict on a simulated project."""
    with tempfile.TemporaryDirectory() as folder:
        write_logs(simulate(recipe), Path(folder))
        return ask_gate(Path(folder))


def draw_recipe(seed: int) -> Recipe:
    """Return a project without a fault: runs, test runs or none, a hidden effect or none."""
    rng = np.random.default_rng(seed)
    tests = tuple(str(kind) for kind in rng.choice(KINDS, size=int(rng.integers(0, 5))))
    hidden = rng.choice(HIDDEN, size=int(rng.integers(0, 2)), replace=False)
    return Recipe(
        seed=seed,
        train=("chamber",) * int(rng.integers(2, 6)),
        test=tests,
        told=(EffectChoice("zero_tempco"), EffectChoice("dark_current")),
        hidden=tuple(EffectChoice(str(name)) for name in hidden),
        dwell=False,
        tare=str(rng.choice(["start", "none"])),
        duration_s=float(rng.choice([1200.0, 1800.0, 3600.0])),
        network=str(rng.choice(["none", "lag_bank"])),
    )


def describe(verdict: GateVerdict) -> str:
    """Return the verdict in a few words."""
    kinds = ", ".join(dict.fromkeys(statement.kind for statement in verdict.refused))
    told = ", ".join(dict.fromkeys(statement.kind for statement in verdict.warnings))
    return (f"REFUSED ({kinds})" if kinds else "passes") + (f", told: {told}" if told else "")


def bound_rate(found: int, count: int) -> float:
    """Return the one-sided Clopper-Pearson bound of a rate of which `found` of `count` were met."""
    if found == count:
        return 1.0

    def reach(rate: float) -> float:
        return sum(
            math.comb(count, k) * rate**k * (1.0 - rate) ** (count - k) for k in range(found + 1)
        )

    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reach(middle) > 1.0 - CONFIDENCE else (low, middle)
    return high


if __name__ == "__main__":
    main(False)
