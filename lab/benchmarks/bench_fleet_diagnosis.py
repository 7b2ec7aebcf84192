"""What `diagnose` finds over the units of a fleet, and what each unit's logs show alone.

Simulated fleets: every unit is a sensor of its own with a few short runs and no dwell, as a test
bench leaves them.

    python -m benchmarks.bench_fleet_diagnosis PURPOSE [--fleets N] [--units N] [--runs N]
                                               [--rows N] [--size X] [--seed N] [--json FILE]

PURPOSE is null (nothing hidden), weak (one effect in all units, drawn from those that a short
chamber run excites) or odd (nothing hidden but in one unit, which has creep or a lag of 3 times the
noise). Rates stand beside their one-sided 95 % Clopper-Pearson bound.
"""

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_conditions import bound, read_rows
from benchmarks.hidden.cases import read_simulation
from zerodrift.base.config import EffectConfig
from zerodrift.base.fleet_config import OUTLIER_Z
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.fleet.evidence import find_differences, look_at_unit, pool_units
from zerodrift.physics.catalogue import load_catalogue
from zerodrift_lab.twin.recipe import EffectChoice, Recipe
from zerodrift_lab.twin.simulate import simulate

WEAK = ("thermal_lag", "thermal_gradient", "warm_up", "span_tempco", "supply_sensitivity")
ODD = ("creep", "thermal_lag")
ODD_SIZE = 3.0
PURPOSES = ("null", "weak", "odd")


def run_fleet(purpose: str, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Return what is found in one simulated fleet."""
    rng = np.random.default_rng(seed)
    hidden = str(rng.choice(WEAK if purpose == "weak" else ODD)) if purpose != "null" else ""
    odd = int(rng.integers(options.units)) if purpose == "odd" else -1
    catalogue = load_catalogue()
    begin = time.process_time()
    units, alone = [], Counter[str]()
    effects = [EffectConfig(choice.name) for choice in Recipe().told]
    for number in range(options.units):
        here = hidden if purpose == "weak" or number == odd else ""
        recipe = Recipe(
            seed=int(rng.integers(2**31)),
            train=("chamber",) * options.runs,
            hidden=(EffectChoice(here),) if here else (),
            size=(options.size if purpose == "weak" else ODD_SIZE) if here else None,
            duration_s=float(options.rows),
            dwell=False,
        )
        dataset = read_simulation(simulate(recipe))
        units.append(look_at_unit(f"SN{number:03d}", dataset, catalogue, effects))
        if options.alone:
            found_alone = diagnose(effects, dataset, catalogue)
            alone[found_alone.effect or found_alone.verdict] += 1
    joint = pool_units(units, catalogue, effects)
    odd_ones = find_differences(joint.units, joint.missing, catalogue, effects, OUTLIER_Z)
    return {
        "purpose": purpose,
        "seed": seed,
        "hidden": hidden,
        "odd": f"SN{odd:03d}" if odd >= 0 else "",
        "missing": [m.kind for m in joint.missing],
        "explained": joint.explained,
        "lookalikes": list(joint.lookalikes),
        "p": joint.candidates[0].p_value if joint.candidates else 1.0,
        "differences": [[d.sensor, d.effect, d.quantity, round(d.z, 1)] for d in odd_ones],
        "alone": dict(alone),
        "seconds": time.process_time() - begin,
    }


def print_rates(rows: Sequence[dict[str, Any]]) -> None:
    """Print a line for each purpose."""
    for purpose in PURPOSES:
        mine = [r for r in rows if r["purpose"] == purpose]
        if not mine:
            continue
        count = len(mine)
        named = [r for r in mine if r["missing"] and r["explained"]]
        told = [r for r in mine if r["differences"]]
        print(f"{purpose}: {count} fleets (simulated)")

        def rate(what: str, hits: int, *, upper: bool, count: int = count) -> None:
            side = "at most" if upper else "at least"
            limit = 100.0 * bound(hits, count, upper=upper)
            print(f"  {what}: {hits} of {count} ({side} {limit:.1f} %)")

        if purpose == "weak":
            right = [r for r in named if r["hidden"] in (r["missing"][0], *r["lookalikes"])]
            rate("named, or in its look-alikes, by all units together", len(right), upper=False)
            rate("another one named", len(named) - len(right), upper=True)
        else:
            rate("an effect named for the fleet", len(named), upper=True)
        if purpose == "odd":
            hit = [r for r in told if any(d[0] == r["odd"] for d in r["differences"])]
            rate("the odd unit told", len(hit), upper=False)
            by_name = [
                r
                for r in hit
                if any(d[1] == r["hidden"] and d[2] == "gain" for d in r["differences"])
            ]
            rate("with the name of its effect", len(by_name), upper=False)
            wrong = [r for r in told if any(d[0] != r["odd"] for d in r["differences"])]
            rate("another unit named", len(wrong), upper=True)
        else:
            rate("a unit said to differ", len(told), upper=True)
        alone = sum((Counter(r["alone"]) for r in mine), Counter[str]())
        if alone:
            words = ", ".join(f"{name} {times}" for name, times in alone.most_common())
            print(f"  each unit alone: {words}")
        print(f"  median {np.median([r['seconds'] for r in mine]):.0f} CPU s a fleet")


def main(arguments: Sequence[str] | None = None) -> int:
    """Simulate fleets and print the rates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("purpose", choices=PURPOSES)
    parser.add_argument("--fleets", type=int, default=10)
    parser.add_argument("--units", type=int, default=20)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--rows", type=int, default=300)
    parser.add_argument("--size", type=float, default=0.25)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--alone", action="store_true", help="diagnose each unit alone too")
    parser.add_argument("--json", type=Path, help="append outcomes here, and go on from them")
    options = parser.parse_args(arguments)
    rows = read_rows(options.json) if options.json else []
    known = {(r["purpose"], r["seed"]) for r in rows}
    for seed in range(options.seed, options.seed + options.fleets):
        if (options.purpose, seed) in known:
            continue
        rows.append(run_fleet(options.purpose, seed, options))
        if options.json:
            with options.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print_rates(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
