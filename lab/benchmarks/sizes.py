"""Flash, RAM, stack and instructions of golden models on every core, against main's last commit.

`make sizes` prints; `python -m benchmarks.sizes --update` records what `main` will show the next
one. Bytes are those of the clang in the ziglang wheel at -Os, instructions those of its code at
-O2, counted by unicorn; another version of the wheel gives other ones.
"""

import argparse
import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from zerodrift.base.files import write_whole
from zerodrift.c_runtime.cores import CORES
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.verify.vectors import draw_sequences

RECORD = Path(__file__).with_suffix(".json")
GOLDEN_DIRECTORY = Path(__file__).parents[2] / "tests" / "golden"
KINDS = {
    "flash_bytes": "flash",
    "ram_bytes": "ram",
    "stack_bytes": "stack",
    "instructions_per_step": "instr/step",
    "instructions_per_mac": "instr/MAC",
}
"""Key in the record -> heading of the column."""
SUFFIX = ".model.json"
COUNTED_STEPS = 3
Table = dict[str, dict[str, dict[str, float]]]
"""Model -> core -> kind -> bytes or instructions."""


def main() -> None:
    """Measure, print, and with --update record."""
    names = [path.name.removesuffix(SUFFIX) for path in sorted(GOLDEN_DIRECTORY.glob(f"*{SUFFIX}"))]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("models", nargs="*", metavar="MODEL", help=f"of {', '.join(names)}")
    parser.add_argument("--update", action="store_true", help="record the table")
    parser.add_argument("--against", default="main", metavar="COMMIT", help="default: main")
    arguments = parser.parse_args()
    if unknown := set(arguments.models) - set(names):
        parser.error(f"no golden model {', '.join(sorted(unknown))}; there are {', '.join(names)}")
    recorded, source = read_record(arguments.against)
    print(f"against the table of {source}")
    table = measure(arguments.models or names)
    print_table(table, recorded)
    print(summarise(table, recorded, source))
    if arguments.update:
        merged = (recorded if arguments.models else {}) | table
        write_whole(RECORD, (json.dumps(merged, indent=1, sort_keys=True) + "\n").encode())


def read_record(commit: str) -> tuple[Table, str]:
    """Return the table recorded in a commit, and what it is called.

    Where there is no such commit (a source archive, a clone of one branch) it is origin's branch of
    that name, and at last the table that lies here.
    """
    place = RECORD.relative_to(RECORD.parent.parent).as_posix()
    for name in (commit, f"origin/{commit}"):
        done = subprocess.run(
            ["git", "show", f"{name}:{place}"],
            cwd=RECORD.parent.parent, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode == 0:
            return json.loads(done.stdout), f"{name} ({find_commit(name)})"
    if not RECORD.exists():
        return {}, "nothing: none was recorded"
    return json.loads(RECORD.read_text(encoding="utf-8")), f"{place}, as there is no '{commit}'"


def find_commit(name: str) -> str:
    """Return the short hash of a commit."""
    done = subprocess.run(
        ["git", "rev-parse", "--short", name],
        cwd=RECORD.parent, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip()


def measure(names: Sequence[str]) -> Table:
    """Return bytes and instructions of golden models on every core."""
    table: Table = {}
    for number, name in enumerate(names, start=1):
        model = load_model(GOLDEN_DIRECTORY / f"{name}{SUFFIX}")
        code = generate(model)
        table[name] = {}
        for core in CORES:
            if sys.stderr.isatty():
                print(f"\r\33[K{number}/{len(names)} {name} on {core}", end="", file=sys.stderr)
            size = measure_footprint(code, core)
            table[name][core] = {
                "flash_bytes": size.flash_bytes,
                "ram_bytes": size.ram_bytes,
                "stack_bytes": size.stack_bytes,
                **count_instructions(model, code, core),
            }
    if sys.stderr.isatty():
        print("\r\33[K", end="", file=sys.stderr)
    return table


def count_instructions(model: IntegerModel, code: GeneratedCode, core: str) -> dict[str, float]:
    """Return the instructions of a step, the most of a few, and of the recurrent layer per MAC.

    Empty where unicorn is not installed.
    """
    if importlib.util.find_spec("unicorn") is None:
        return {}
    from zerodrift.c_runtime.emulator import EmulatedModel

    with tempfile.TemporaryDirectory() as folder:
        chip = EmulatedModel(model, code, core, Path(folder))
        codes = draw_sequences(model, 50)["noise"][:COUNTED_STEPS]
        counted: dict[str, float] = {"instructions_per_step": max(chip.count_instructions(codes))}
        if macs := count_macs(model):
            counted["instructions_per_mac"] = round(chip.count_layer() / macs, 3)
    return counted


def count_macs(model: IntegerModel) -> int:
    """Return the multiply-accumulates of one step of the first GRU or else LSTM, 0 without one."""
    layer = model.recurrent
    if layer is None:
        stacks = [n.layers for n in model.recurrents if isinstance(n, IntegerLstmLayer)]
        return (
            sum(4 * lstm.hidden * (lstm.hidden + lstm.inputs) for lstm in stacks[0])
            if stacks
            else 0
        )
    return sum(3 * gru.hidden * (gru.hidden + gru.inputs) for gru in layer.layers)


def print_table(table: Table, recorded: Table) -> None:
    """Print one line per model and core, each number with its difference to the record."""
    print(f"{'model':14} {'core':14}" + "".join(f"{heading:>17}" for heading in KINDS.values()))
    for model, cores in table.items():
        for core, sizes in cores.items():
            before = recorded.get(model, {}).get(core, {})
            cells = [describe(sizes.get(kind), before.get(kind)) for kind in KINDS]
            print(f"{model:14} {core:14}" + "".join(f"{cell:>17}" for cell in cells))


def describe(size: float | None, before: float | None) -> str:
    """Return a number and what it changed by."""
    if size is None:
        return "-"
    if before is None:
        return f"{size} (new)"
    change = round(size - before, 3)
    return f"{size} ({change:+})" if change else f"{size}"


def summarise(table: Table, recorded: Table, source: str) -> str:
    """Return one line on how many numbers became smaller, larger or are new."""
    changes = [
        None if kind not in before else number - before[kind]
        for model, cores in table.items()
        for core, sizes in cores.items()
        for kind, number in sizes.items()
        for before in [recorded.get(model, {}).get(core, {})]
    ]
    known = [change for change in changes if change is not None]
    smaller, larger = sum(c < 0 for c in known), sum(c > 0 for c in known)
    told = f"{len(changes)} numbers: {smaller} smaller, {larger} larger than in {source}"
    return f"{told}, {len(changes) - len(known)} new"


if __name__ == "__main__":
    main()
