"""Flash, RAM and stack of every golden model on every core, against the last recorded table.

`make sizes` prints; `python benchmarks/sizes.py --update` records. The numbers are those of the
clang in the ziglang wheel at -Os; another version of it gives other ones.
"""

import argparse
import json
from pathlib import Path

from zerodrift.c_runtime.cores import CORES
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import load_model

RECORD = Path(__file__).with_suffix(".json")
GOLDEN_DIRECTORY = Path(__file__).parent.parent / "tests" / "golden"
KINDS = ("flash_bytes", "ram_bytes", "stack_bytes")
Table = dict[str, dict[str, dict[str, int]]]
"""Model -> core -> kind -> bytes."""


def main() -> None:
    """Measure, print, and with --update record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--update", action="store_true", help="record the table")
    arguments = parser.parse_args()
    recorded: Table = json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {}
    table = measure()
    print_table(table, recorded)
    if arguments.update:
        temporary = RECORD.with_suffix(".part")
        temporary.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
        temporary.replace(RECORD)


def measure() -> Table:
    """Return the footprint of every golden model on every core."""
    table: Table = {}
    for path in sorted(GOLDEN_DIRECTORY.glob("*.model.json")):
        code = generate(load_model(path))
        sizes = {core: measure_footprint(code, core) for core in CORES}
        table[path.name.removesuffix(".model.json")] = {
            core: {kind: getattr(size, kind) for kind in KINDS} for core, size in sizes.items()
        }
    return table


def print_table(table: Table, recorded: Table) -> None:
    """Print bytes per model and core, each with its difference to the record."""
    print(f"{'model':14} {'core':14}" + "".join(f"{kind[:-6]:>16}" for kind in KINDS))
    for model, cores in table.items():
        for core, sizes in cores.items():
            before = recorded.get(model, {}).get(core, {})
            cells = [describe(sizes[kind], before.get(kind)) for kind in KINDS]
            print(f"{model:14} {core:14}" + "".join(f"{cell:>16}" for cell in cells))


def describe(size: int, before: int | None) -> str:
    """Return a size and what it changed by."""
    if before is None:
        return f"{size} (new)"
    return f"{size}" if size == before else f"{size} ({size - before:+d})"


if __name__ == "__main__":
    main()
