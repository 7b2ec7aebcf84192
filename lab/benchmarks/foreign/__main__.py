"""How often zerodrift is right about foreign logs: `python -m benchmarks.foreign [--quick]`."""

import argparse
import json
import math
import random
import statistics
import tempfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.foreign import case, effects, files, judge

Row = dict[str, Any]


def recipes(seed: int) -> Iterator[case.Recipe]:
    """Recipes without end: the catalogue in turn, and between them all other kinds."""
    rng = random.Random(seed)
    for number, name in enumerate(name for _ in iter(int, 1) for name in effects.CATALOGUE):
        kinds: list[tuple[str, tuple[str, ...]]] = [("effect", (name,))]
        if number % 3 == 0:
            kinds.append(("complete", ()))
        if number % 4 == 1:
            kinds.append(("pair", tuple(rng.sample(effects.CATALOGUE[:-1], 2))))
        if number % 4 == 2:
            kinds.append(("disturbance", (rng.choice(effects.DISTURBANCES),)))
        if number % 6 == 3:
            kinds.append(("missing_channel", (rng.choice(list(effects.CHANNEL_OF)[:-1]),)))
        for kind, hidden in kinds:
            size, runs = rng.choice([1, 1.5, 2, 3, 5, 10]), rng.choice([8, 8, 9, 10, 12, 14])
            yield case.Recipe(kind, hidden, size, runs, rng.randrange(1 << 31))


def share(good: list[bool]) -> str:
    """A share with its Wilson interval of 95 %."""
    if not good:
        return "none"
    count, rate, z = len(good), sum(good) / len(good), 1.96
    middle = (rate + z * z / (2 * count)) / (1 + z * z / count)
    spread = math.sqrt(rate * (1 - rate) / count + z * z / (4 * count * count))
    half = z * spread / (1 + z * z / count)
    low, high = abs(middle - half), middle + half
    return f"{sum(good):4d} of {count:4d} {rate:7.1%}  [{low:6.1%}, {high:6.1%}]"


def table(rows: list[Row]) -> str:
    """The rows as the table of targets, then what departed from the contract."""
    of = {kind: [row for row in rows if row["kind"] == kind] for kind in judge.KINDS}
    single = of["effect"]
    wrong = [row.get("verdict") == "missing" and not judge.grouped(row) for row in single]
    small = [judge.grouped(row) and len(row["lookalikes"]) < 2 for row in single]
    values = [value for row in single for value in row.get("intervals", [])]
    after = [ratio for row in single for ratio in row.get("after_floor", [])]
    lines = {
        "effect named first": share([judge.first(row) for row in single]),
        "effect named, or in a group of at most two": share(small),
        "another named, without it in the group": share(wrong),
        "both of two found by --auto": share([judge.both(row) for row in of["pair"]]),
        "complete model called complete": share(
            [r.get("verdict") == "complete" for r in of["complete"]]
        ),
    }
    for kind in ("complete", "disturbance", "missing_channel"):
        lines[judge.KINDS[kind]] = share([row.get("verdict") == "missing" for row in of[kind]])
    lines["fitted value within its 95 % interval"] = share(
        [abs(said - true) <= 1.96 * error for _, true, said, error in values]
    )
    lines["held-out error after adding / floor"] = (
        f"median {statistics.median(after):.3f}" if after else "none"
    )
    told = [f"{row['project']}: {text}" for row in rows for text in row["complaints"]]
    return "\n".join([*(f"{words:43s} {text}" for words, text in lines.items()), *told])


def main() -> None:
    """Draw cases, run the commands on each, print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.foreign", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="24 cases instead of 300")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="keep the projects and results.jsonl here")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        home = arguments.keep or Path(scratch)
        rows = []
        for number, recipe in enumerate(
            islice(recipes(arguments.seed), 24 if arguments.quick else 300)
        ):
            place = home / f"{number:03d}_{recipe.kind}_{'+'.join(recipe.hidden)}"
            project = files.write(case.draw(recipe), place)
            rows.append(judge.examine(project, json.loads((place / "truth.json").read_text())))
            with (home / "results.jsonl").open("a") as results:
                results.write(json.dumps(rows[-1]) + "\n")
        print(f"simulated logs, seed {arguments.seed}, size >= 1, 8 to 14 runs\n{table(rows)}")


if __name__ == "__main__":
    main()
