"""How often the diagnosis was right: the tables, the misses and the targets."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.stats import binomtest

from benchmarks.hidden.cases import LISTED
from benchmarks.hidden.outcomes import Outcome

TARGETS = {
    "named first or in a group of two, size >= 1, >= 8 runs": (">=", 0.97),
    "named first, size >= 1, >= 8 runs": (">=", 0.92),
    "wrong effect named, size >= 1, >= 8 runs": ("<=", 0.01),
    "false alarm on a complete model": ("<=", 0.03),
    "outside effect falsely named, size >= 1": ("<=", 0.05),
    "missing channel falsely named, size >= 1": ("<=", 0.05),
    "both of two effects found": (">=", 0.90),
    "median held-out error over floor after adding": ("<=", 1.05),
    "parameter within its 95 % interval": (">=", 0.90),
    "parameter within its 95 % interval, at most": ("<=", 0.99),
}


def tell(name: str, hits: Iterable[bool]) -> float:
    """Print a share with its 95 % interval, after Wilson, and return it."""
    values = list(hits)
    if not values:
        print(f"{name:58s} no such case")
        return math.nan
    share = sum(values) / len(values)
    low, high = binomtest(sum(values), len(values)).proportion_ci(method="wilson")
    print(f"{name:58s} {share:6.1%}  ({low:.1%} .. {high:.1%})  of {len(values)}")
    return share


def report(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Print the tables and return the figures that have targets."""
    good = [o for o in outcomes if not o.refused]
    one = [o for o in good if o.case.purpose == "one"]
    print("\nnamed first / named wrongly, by effect and size (simulated)")
    sizes = sorted({o.case.size for o in one})
    print(f"{'effect':20s}" + "".join(f"{size:>12g}" for size in sizes))
    for effect in LISTED:
        cells = []
        for size in sizes:
            here = [o for o in one if o.case.hidden == (effect,) and o.case.size == size]
            first, wrong = sum(o.first for o in here), sum(o.wrong for o in here)
            cells.append(f"{first}/{len(here)}" + (f" ({wrong} wrong)" if wrong else ""))
        print(f"{effect:20s}" + "".join(f"{cell:>12s}" for cell in cells))
    print()
    large = [o for o in one if o.case.size >= 1.0 and o.case.runs >= 8]
    figures = {
        name: tell(name, hits)
        for name, hits in (
            (
                "named first or in a group of two, size >= 1, >= 8 runs",
                [o.in_group for o in large],
            ),
            ("named first, size >= 1, >= 8 runs", [o.first for o in large]),
            ("wrong effect named, size >= 1, >= 8 runs", [o.wrong for o in large]),
            (
                "false alarm on a complete model",
                [o.verdict != "complete" for o in good if o.case.purpose == "complete"],
            ),
            (
                "outside effect falsely named, size >= 1",
                [o.effect is not None for o in good if o.case.purpose == "outside"],
            ),
            (
                "missing channel falsely named, size >= 1",
                [o.effect is not None for o in good if o.case.purpose == "no channel"],
            ),
            (
                "both of two effects found",
                [set(o.case.hidden) <= set(o.added) for o in good if o.case.purpose == "pair"],
            ),
        )
    }
    tell(
        "outside effect called unknown",
        [o.verdict == "unknown" for o in good if o.case.purpose == "outside"],
    )
    tell(
        "two effects found and nothing else",
        [set(o.case.hidden) == set(o.added) for o in good if o.case.purpose == "pair"],
    )
    few = [o for o in one if o.case.runs < 8]
    tell("named first, size 2, 4 to 7 runs", [o.first for o in few])
    tell("wrong effect named, size 2, 4 to 7 runs", [o.wrong for o in few])
    small = [o for o in one if o.case.size < 1.0]
    tell("named first, size < 1", [o.first for o in small])
    tell("wrong effect named, size < 1", [o.wrong for o in small])
    inside = tell(
        "parameter within its 95 % interval",
        [low <= truth <= high for o in good for _, truth, low, high in o.shapes],
    )
    figures["parameter within its 95 % interval"] = inside
    figures["parameter within its 95 % interval, at most"] = inside
    for name in sorted({shape[0] for o in good for shape in o.shapes}):
        tell(
            f"  {name}",
            [s[1] >= s[2] and s[1] <= s[3] for o in good for s in o.shapes if s[0] == name],
        )
    after = [o.after for o in large if o.first]
    figures["median held-out error over floor after adding"] = float(np.median(after))
    print(f"{'median held-out error over floor after adding':58s} {np.median(after):6.3f}")
    print(
        f"{'median seconds of processor time per diagnosis':58s} "
        f"{np.median([o.seconds for o in good if o.case.purpose != 'pair']):6.2f}"
    )
    refused = [o for o in outcomes if o.refused]
    if refused:
        print(f"{len(refused)} cases that the simulator cannot make, not counted:")
        for o in refused:
            print(f"  {'+'.join(o.case.hidden)} size {o.case.size:g}: {o.refused[:90]}")
    return figures


def list_misses(outcomes: Sequence[Outcome]) -> None:
    """Print every case that did not go as it should."""
    print("\nmisses")
    for o in outcomes:
        expected = {
            "one": o.first,
            "pair": set(o.case.hidden) <= set(o.added),
            "complete": o.verdict == "complete",
        }.get(o.case.purpose, o.verdict == "unknown")
        if not o.refused and not expected:
            print(
                f"  {o.case.purpose}: {'+'.join(o.case.hidden) or '-'} size {o.case.size:.2g} "
                f"runs {o.case.runs} seed {o.case.seed}: {o.verdict} {o.effect or ''} "
                f"{o.lookalikes or ''} nearest {o.nearest} added {o.added} "
                f"floor {o.before:.2f} -> {o.after:.2f}"
            )


def check(figures: dict[str, float]) -> bool:
    """Print each target with what was reached; return whether all are met."""
    print("\ntargets")
    met = True
    for name, (sign, bound) in TARGETS.items():
        value = figures[name]
        good = value >= bound if sign == ">=" else value <= bound
        met = met and good
        print(f"  {'met   ' if good else 'MISSED'} {name}: {value:.3f} {sign} {bound}")
    return met
