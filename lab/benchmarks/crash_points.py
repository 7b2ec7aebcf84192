"""Crash points: `python -m benchmarks.crash_points [COMMAND ...]`.

Runs every command that writes once, and copies its project before each call that changes the disk
(open for writing, rename, link, unlink, mkdir, rmdir, fsync): each copy is what a kill there would
leave. In each, the next command's first step is taken; then every set of files that belong together
has to be the old one or the new one, and nothing may lie about. Prints the points, and those that
fail. Exit code 1 if there is one.
"""

import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tests.faults.scenarios import SCENARIOS, Scenario, find_set
from tests.state.faults import Tree, list_crashes, read_tree

from zerodrift.base.errors import ZerodriftError
from zerodrift.base.journal import hold_project
from zerodrift.cli.main import cli


def run(project: Path, arguments: tuple[str, ...]) -> int:
    """Run the command line in this process; return its exit code."""
    try:
        cli.main([a.replace("{}", str(project)) for a in arguments], standalone_mode=False)
    except SystemExit as end:
        return int(end.code or 0)
    except ZerodriftError as error:
        return error.exit_code
    return 0


def split(tree: Tree) -> dict[str, Tree]:
    """Return the files of each set; what a reader does not see is no part of one."""
    sets: dict[str, Tree] = {}
    for name, content in tree.items():
        if not is_hidden(name):
            sets.setdefault(find_set(name), {})[name] = content
    return sets


def is_hidden(name: str) -> bool:
    """Return whether a name is one of those that only a command under way uses."""
    return any(part.startswith(".") for part in name.split("/"))


def examine(scenario: Scenario, folder: Path) -> tuple[int, list[str]]:
    """Return the points of one command, and what is wrong at which."""
    project = folder / "project"
    scenario.prepare(project, run)
    old = split(read_tree(project))
    crashes = list_crashes(project, lambda: run(project, scenario.arguments), folder / "crashes")
    new = split(read_tree(project))
    wrong = []
    for place in crashes:
        with hold_project(place):
            pass
        tree = read_tree(place)
        wrong += [f"{place.name}: {name} lies about" for name in tree if is_hidden(name)]
        found = split(tree)
        for name in {*old, *new, *found}:
            if found.get(name) not in (old.get(name), new.get(name)):
                wrong.append(f"{place.name}: {name} is mixed")
    return len(crashes), wrong


def main(quick: bool, names: Sequence[str] = ()) -> int:
    """Examine all commands, those named, or the first if quick; return how many points fail."""
    points, wrong = 0, 0
    chosen = [s for s in SCENARIOS if not names or s.name in names]
    for scenario in chosen[:1] if quick else chosen:
        with tempfile.TemporaryDirectory(prefix="zd-crash-") as name:
            count, found = examine(scenario, Path(name).resolve())
        points, wrong = points + count, wrong + len(found)
        print(f"{scenario.name}: {count} crash points, {len(found)} wrong", file=sys.stderr)
        for line in found:
            print(f"  {line}", file=sys.stderr)
    print(f"crash points: {points}, of which {wrong} leave a mixed set or a stray")
    return wrong


if __name__ == "__main__":
    sys.exit(1 if main(quick=False, names=sys.argv[1:]) else 0)
