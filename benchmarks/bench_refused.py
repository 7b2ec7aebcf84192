"""Whether `add` keeps what `diagnose` names: the twelve conditions, each with cases of all kinds.

Every named effect goes through the command's own judgement (`revise_best` with the forms that `add`
tries), on the logs as they were read. Cases are those of `bench_conditions`, all simulated.

    python -m benchmarks.bench_refused [CONDITION ...] [--count N] [--seed N] [--minutes M]
                                       [--json FILE]

COUNT cases are drawn of each condition: two thirds with an effect hidden, the others complete. With
--json outcomes are appended, and cases that the file has are not run again.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.bench_conditions import CONDITIONS, Condition, bound, change, list_cases, read_rows
from benchmarks.hidden.cases import Case, make_recipe, read_simulation
from zerodrift.base.config import Config, EffectConfig, parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import propose_command, propose_forms
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.revision import revise_best
from zerodrift.lab.twin.simulate import simulate
from zerodrift.physics.catalogue import load_catalogue


def open_config(effects: Sequence[EffectConfig], dataset: Dataset, folder: Path) -> Config:
    """Return a project of these effects; the logs are given, so that none of it is read."""
    tables = "".join(f'\n[[effect]]\nkind = "{effect.kind}"\n' for effect in effects)
    outputs = "".join(
        f'\n[outputs.{name}]\nmeasured = "{name}"\nunit = "{unit}"\nfull_scale = {scale:g}\n'
        for name, unit, scale in zip(
            dataset.outputs, dataset.units, dataset.full_scale, strict=True
        )
    )
    text = (
        '[sensor]\nname = "s"\ntime = "t"\ntemperature = "T"\nsample_period_s = 1.0\n'
        f'{outputs}\n[logs]\ntrain = ["a.csv"]\n{tables}'
    )
    return parse_config(text, folder / "zerodrift.toml")


def ask(condition: Condition, case: Case) -> dict[str, object]:
    """Return what is named, and why `add` would not keep it."""
    recipe = make_recipe(case)
    row: dict[str, object] = {"seed": case.seed, "hidden": case.hidden, "runs": case.runs}
    try:
        dataset = change(read_simulation(simulate(recipe)), condition, case.seed)
    except InputError as error:
        return {**row, "skipped": str(error)}
    catalogue = load_catalogue()
    effects = [EffectConfig(choice.name) for choice in recipe.told]
    found = diagnose(effects, dataset, catalogue)
    row |= {"verdict": found.verdict, "effect": found.effect, "nearest": found.nearest}
    if found.effect is None:
        return {**row, "remarks": [r for r in found.remarks if "enough for `add`" in r]}
    command = propose_command(effects, catalogue[found.effect], found.parameters)
    words = (word.partition("=") for word in command.options if "=" in word)
    held = {name: float(value) for name, _, value in words}
    with tempfile.TemporaryDirectory() as folder:
        config = open_config(effects, dataset, Path(folder))
        wanted = EffectConfig(found.effect, held)
        forms = propose_forms(config, dataset, catalogue, wanted)
        revision = revise_best(config, dataset, catalogue, forms)
    return {**row, "kept": revision.helps, "why": revision.reason, "held": held}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and print a line for each condition."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("conditions", nargs="*", metavar="CONDITION")
    parser.add_argument("--count", type=int, default=18)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=60.0, help="stop after so long")
    parser.add_argument("--json", type=Path, help="append outcomes here, and go on from them")
    options = parser.parse_args(arguments)
    unknown = set(options.conditions) - set(CONDITIONS)
    if unknown:
        parser.error(f"no condition {', '.join(unknown)}; known: {', '.join(CONDITIONS)}")
    rows = read_rows(options.json) if options.json else []
    known = {(r["condition"], r["seed"]) for r in rows}
    begin = time.monotonic()
    for name in options.conditions or tuple(CONDITIONS):
        condition = CONDITIONS[name]
        cases = [list_cases(condition, p, options.seed) for p in ("one", "one", "complete")]
        cases[1] = cases[0]
        for number in range(options.count):
            case = next(cases[number % 3])
            late = time.monotonic() - begin > 60.0 * options.minutes
            if late or (name, case.seed) in known:
                continue
            rows.append({"condition": name, **ask(condition, case)})
            if options.json:
                with options.json.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
        mine = [r for r in rows if r["condition"] == name and "verdict" in r]
        of_them = [r for r in mine if r["effect"] is not None]
        refused = [r for r in of_them if not r["kept"]]
        if not mine:
            continue
        most = 100.0 * bound(len(refused), max(len(of_them), 1), upper=True)
        print(
            f"{name:18s} {len(mine):3d} cases, {len(of_them)} named, `add` refuses {len(refused)} "
            f"(at most {most:.1f} %)",
            flush=True,
        )
        for r in refused:
            print(f"    seed {r['seed']} hidden {r['hidden']}: {r['effect']}: {r['why']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
