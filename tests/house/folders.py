"""Folders that `zerodrift firmware` enters between reading and writing.

    python -m tests.house.folders [PROJECT]

A folder is entered where a function of a module in it is called after the logs were read and before
the first file of the firmware is written; importing a module calls none. Without PROJECT, that of a
simulated sensor with a lag bank and one effect. A folder within a stage, such as train/lag_bank, is
counted beside its stage. The folders of operations are counted apart: a model enters those of which
it is made.
"""

import sys
import tempfile
import threading
from collections import Counter
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import CodeType, FrameType

from click.testing import CliRunner
from tests.house.test_order import FOLDERS
from tests.projects import render_toml

from zerodrift.cli.main import cli

TOML = render_toml("""\
[logs]
train = ["logs/train_*.csv"]
test = ["logs/test_*.csv"]

[[effect]]
kind = "zero_tempco"

[network]
kind = "lag_bank"

[firmware]
out = "firmware"
""")

EDGES = {
    ("return", "open_project"): "tasks/project.py",
    ("call", "write_artefacts"): "verify/firmware.py",
}
"""Where reading ends and where writing begins."""


def write_project(directory: Path) -> Path:
    """Write a project of simulated logs with a hidden lag; return its directory."""
    from zerodrift_lab.twin import Recipe, parse_choice, simulate, write_logs

    simulated = directory / "simulated"
    write_logs(simulate(Recipe(seed=3, hidden=(parse_choice("thermal_lag"),))), simulated)
    names = ("train_1", "train_2", "train_3", "test_1")
    (directory / "logs").mkdir()
    for name, log in zip(names, sorted((simulated / "logs").glob("*.csv")), strict=False):
        lines = log.read_text().splitlines(keepends=True)[:1800]
        (directory / "logs" / f"{name}.csv").write_text("".join(lines))
    (directory / "zerodrift.toml").write_text(TOML)
    return directory


class Entered:
    """Counts the functions of each folder that are called."""

    def __init__(self) -> None:
        self.functions: Counter[Path] = Counter()
        self._between = False
        self._seen: set[CodeType] = set()
        self._roots = {folder.resolve(): name for name, folder in FOLDERS.items()}

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        """Be told of a call, as a profiler is."""
        code = frame.f_code
        if (event, code.co_name) in EDGES and code.co_filename.endswith(EDGES[event, code.co_name]):
            self._between = event == "return"
        if event != "call" or code in self._seen or not self._between:
            return
        self._seen.add(code)
        if not code.co_flags & CO_OPTIMIZED or code.co_name.startswith("<"):
            return  # the body of a module or a class, which importing runs
        file = Path(code.co_filename)
        if file.suffix != ".py":
            return  # a template, which its own stage renders
        folder = file.resolve().parent
        for above in (folder, *folder.parents):
            if (name := self._roots.get(above)) is not None:
                self.functions[Path(name) / folder.relative_to(above)] += 1
                return


def trace_firmware(project: Path) -> Counter[Path]:
    """Return folder -> functions of it that `zerodrift firmware` calls.

    Raises:
        RuntimeError: the command fails.
    """
    entered = Entered()
    threading.setprofile(entered)
    sys.setprofile(entered)
    try:
        result = CliRunner().invoke(cli, ["firmware", "-C", str(project)])
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    if result.exit_code != 0:
        raise RuntimeError(result.output or repr(result.exception))
    return entered.functions


def main() -> None:
    """Print the folders and how many there are."""
    with tempfile.TemporaryDirectory(prefix="zerodrift-") as scratch:
        given = sys.argv[1:]
        found = trace_firmware(Path(given[0]) if given else write_project(Path(scratch)))
    for folder, functions in sorted(found.items()):
        print(f"{folder.as_posix():<28} {functions:5d} functions")
    own = sum(folder.parts[0] == "operations" and len(folder.parts) > 1 for folder in found)
    print(f"folders: {len(found) - own}, and {own} of the model's operations")


if __name__ == "__main__":
    main()
