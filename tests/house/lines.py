"""Lines that are kept by hand, folder by folder: `python -m tests.house.lines [--against REV]`.

All lines count, empty ones and comments too. Each folder has a ceiling of lines and modules in
ceilings.toml; a rise is a decision record that says what it buys. --lower takes off what is free,
--against shows the difference to another commit, --long N the files above N lines.
"""

import argparse
import io
import subprocess
import tarfile
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tests.house.test_order import LINKED

ROOT = Path(__file__).resolve().parents[2]
WRITTEN = (".py", ".c", ".h", ".j2", ".js", ".css", ".html")
"""How the names of written files end; what is stored (data, golden files) ends otherwise."""
STORED = ("tests/frozen/", "tests/golden/")
CEILINGS = Path(__file__).with_name("ceilings.toml")
SUMS = {"core": ("src/zerodrift/", *(f"{name}/" for name in LINKED)), "proof": ("proof/",)}
"""Sums of folders, by how their names begin."""


def name_folder(file: str) -> str:
    """Return the folder whose ceiling a file counts for."""
    parts = file.split("/")[:-1]
    deep = {"src": 3, "lab": 2}.get(parts[0] if parts else "", 1)
    return "/".join(parts[:deep]) or "."


def list_texts(revision: str = "") -> Iterator[tuple[str, bytes]]:
    """Yield every file that git keeps and that is written by hand, and what is in it.

    Args:
        revision: a commit; left out, the files as they lie here.
    """
    if revision:
        command = ["git", "archive", "--format=tar", revision]
        packed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            for member in archive:
                if member.isfile() and is_written(member.name):
                    found = archive.extractfile(member)
                    assert found is not None
                    yield member.name, found.read()
        return
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
    for file in filter(is_written, listed.decode("utf-8").split("\0")):
        if (ROOT / file).is_file():  # else it is removed, which the next commit will say
            yield file, (ROOT / file).read_bytes()


def is_written(file: str) -> bool:
    """Return whether a file is written by hand."""
    return file.endswith(WRITTEN) and not file.startswith(STORED) and "/stored/" not in file


def count_lines(revision: str = "") -> dict[str, int]:
    """Return the lines of every file that is written by hand."""
    return {file: text.count(b"\n") for file, text in list_texts(revision)}


def add_up(lines: dict[str, int]) -> dict[str, tuple[int, int]]:
    """Return lines and Python modules of every folder, and of the sums of folders."""
    total: Counter[str] = Counter()
    modules: Counter[str] = Counter()
    for file, count in lines.items():
        sums = [name for name, begin in SUMS.items() if file.startswith(begin)]
        for name in (name_folder(file), *sums):
            total[name] += count
            modules[name] += file.endswith(".py")
    return {name: (total[name], modules[name]) for name in total}


def read_ceilings() -> dict[str, tuple[int, int]]:
    """Return the most lines and modules of every folder and sum."""
    told = tomllib.loads(CEILINGS.read_text(encoding="utf-8"))
    return {name: (most["lines"], most["modules"]) for name, most in told.items()}


def lower(found: dict[str, tuple[int, int]]) -> None:
    """Write every ceiling down to what its folder holds, and none up.

    Args:
        found: folder -> its lines and modules; one without a ceiling gets it.
    """
    old = read_ceilings()
    text = (
        "# The most lines and Python modules of each folder (`python -m tests.house.lines`).\n"
        "# A rise is a decision record that says what it buys.\n"
    )
    for name in sorted(found):
        lines, modules = map(min, found[name], old.get(name, found[name]))
        text += f'\n["{name}"]\nlines = {lines}\nmodules = {modules}\n'
    CEILINGS.write_text(text, encoding="utf-8")


def main() -> None:
    """Print the lines and modules of each folder beside its ceiling, and the long files."""
    parser = argparse.ArgumentParser(prog="python -m tests.house.lines", description=__doc__)
    parser.add_argument("--against", metavar="REV", help="a commit to show the difference to")
    parser.add_argument("--long", type=int, metavar="N", help="list the files above N lines")
    parser.add_argument(
        "--lower", action="store_true", help="take off what the ceilings leave free"
    )
    given = parser.parse_args()
    lines = count_lines()
    if given.lower:
        lower(add_up(lines))
    if given.long:
        for file, count in sorted(lines.items(), key=lambda item: -item[1]):
            if count > given.long:
                print(f"{count:6d} {file}")
    before = add_up(count_lines(given.against)) if given.against else {}
    ceilings = read_ceilings()
    print(f"{'folder':<28}{'lines':>8}{'most':>8}{'modules':>9}{'most':>6}")
    for folder, (count, modules) in sorted(add_up(lines).items()):
        most = ceilings.get(folder)
        cells = f"{folder:<28}{count:8d}{most[0] if most else '':>8}"
        cells += f"{modules:9d}{most[1] if most else '':>6}"
        if given.against:
            was = before.get(folder, (0, 0))
            cells += f"  {count - was[0]:+7d} {modules - was[1]:+5d}"
        print(cells)


if __name__ == "__main__":
    main()
