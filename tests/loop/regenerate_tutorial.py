"""Runs the commands of the tutorials again and writes what they print into the pages.

    python tests/loop/regenerate_tutorial.py [PAGE...]

A page is Markdown. Its ```console blocks hold `$ command` lines, each followed by what it prints.
A comment `<!-- file: NAME -->` above a code block makes that block a file of the project; a comment
`<!-- needs: NAME -->` names a file of third-party data, looked for in DATA; `<!-- logs: NAME -->`
has simulated logs written first, by `world_logs.py`. All commands of a page run in one new
directory, in order. Read the diff before you commit it.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "tutorial"
HOW_TO = ROOT / "docs" / "how-to"
DATA = ROOT.parent / "shared" / "data"

_BLOCK = re.compile(
    r"(?P<open>^```console\n)(?P<body>.*?)(?P<close>^```$)", re.DOTALL | re.MULTILINE
)
_FILE = re.compile(
    r"<!-- file: (?P<name>\S+) -->\n```\w*\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE
)
_NEEDS = re.compile(r"<!-- needs: (?P<name>\S+) -->")
_LOGS = re.compile(r"<!-- logs: (?P<name>\S+) -->")
_NUMBER = re.compile(r"[-+]?(?:\d+\.\d+|\d+)(?:e[-+]?\d+)?")
TOLERANCE = 0.02
"""Relative difference of a figure on another machine; words must be the same."""


@dataclass(frozen=True)
class Step:
    """One command of a page, and what the page says it prints."""

    command: str
    output: str


def list_pages() -> list[Path]:
    """Return the tutorials, in order of their names."""
    return sorted(path for path in PAGES.glob("*.md") if "```console" in path.read_text("utf-8"))


def list_worlds() -> list[Path]:
    """Return the pages on where logs come from, in order of their names."""
    return sorted(HOW_TO.glob("from-*.md"))


def list_missing_data(page: str) -> list[str]:
    """Return the third-party files that a page needs and that are not here."""
    names = [match["name"] for match in _NEEDS.finditer(page)]
    return [name for name in names if not (DATA / name).is_file()]


def list_blocks(page: str) -> list[str]:
    """Return the bodies of a page's console blocks."""
    return [match["body"] for match in _BLOCK.finditer(page)]


def split_steps(body: str) -> list[Step]:
    """Return the commands of a console block with their outputs."""
    steps: list[Step] = []
    for part in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]:
        command, _, output = part.partition("\n")
        steps.append(Step(command, output))
    return steps


def run_step(command: str, directory: Path) -> str:
    """Return what a command prints in a directory, without the directory's own name."""
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "OMP_NUM_THREADS": "1",
        "LC_ALL": "C.UTF-8",
    }
    environment.pop("COLUMNS", None)
    if sources := os.environ.get("PYTHONPATH"):
        # The commands run in another directory, where a relative path would lead nowhere.
        places = (str(Path(place).resolve()) for place in sources.split(os.pathsep) if place)
        environment["PYTHONPATH"] = os.pathsep.join(places)
    result = subprocess.run(
        ["bash", "-c", command],
        cwd=directory,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        check=False,
    )
    lines = result.stdout.replace(f"{directory}/", "").splitlines()
    return "".join(f"{line.rstrip()}\n" for line in lines)


def walk_page(page: str, visit: Callable[[Step, str], None] = lambda step, output: None) -> str:
    """Run a page's commands and return the page with what they print now.

    Args:
        page: the page's text.
        visit: called with each step as the page has it, and what it printed now.
    """
    with tempfile.TemporaryDirectory(prefix="tutorial-") as name:
        directory = Path(name).resolve()
        for match in _NEEDS.finditer(page):
            shutil.copy(DATA / match["name"], directory)
        for match in _LOGS.finditer(page):
            write_logs(match["name"], directory)
        position, parts = 0, []
        # Files and commands in the order of the page: a file may be written between two commands.
        events = sorted([*_BLOCK.finditer(page), *_FILE.finditer(page)], key=lambda m: m.start())
        for match in events:
            if "name" in match.groupdict():
                (directory / match["name"]).write_text(match["text"], encoding="utf-8")
                continue
            printed = []
            for step in split_steps(match["body"]):
                output = run_step(step.command, directory)
                visit(step, output)
                printed.append(f"$ {step.command}\n{output}")
            parts += [page[position : match.start()], match["open"], *printed, match["close"]]
            position = match.end()
        return "".join([*parts, page[position:]])


def write_logs(name: str, directory: Path) -> None:
    """Write the simulated logs of a page."""
    sys.path.insert(0, str(ROOT))  # as a script this file lies outside of the package
    from tests.loop.world_logs import WORLDS

    WORLDS[name](directory)


def explain_difference(expected: str, found: str) -> str:
    """Return where two outputs differ beyond layout and TOLERANCE; empty if nowhere."""
    ours, theirs = expected.split("\n"), found.split("\n")
    words, others = expected.split(), found.split()
    for one, other in zip(words, others, strict=False):
        if not _agree(one, other):
            return f"expected '{one}', found '{other}'"
    if len(words) != len(others):
        return f"expected {len(ours)} lines, found {len(theirs)}"
    return ""


def _agree(one: str, other: str) -> bool:
    """Return whether two words are the same but for figures that are nearly so."""
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other):
        # A bar of the picture may be a character longer.
        return set(one) | set(other) <= set("│█▏▎▍▌▋▊▉") and abs(len(one) - len(other)) <= 1
    pairs = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
    return all(abs(float(a) - float(b)) <= TOLERANCE * abs(float(a)) + 1e-12 for a, b in pairs)


def main() -> None:
    """Rewrite the pages named, or all."""
    pages = [Path(name) for name in sys.argv[1:]] or [*list_pages(), *list_worlds()]
    for path in pages:
        page = path.read_text("utf-8")
        missing = list_missing_data(page)
        if missing:
            print(f"{path.name}: left as it is, as {DATA / missing[0]} is not here")
            continue
        path.write_text(walk_page(page, lambda step, _: print(f"$ {step.command}")), "utf-8")
        print(f"{path.name}: written")


if __name__ == "__main__":
    main()
