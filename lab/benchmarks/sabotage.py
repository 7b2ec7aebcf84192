"""Sabotage: what lies in firmware/ and build/ is spoilt, one thing at a time; who says so?

`python -m benchmarks.sabotage [--project NAME] [--jobs 2]` makes a small project. Each file it
deletes, cuts in half, empties, flips a bit of, makes uncompilable, or takes from another model; it
changes logs and zerodrift.toml after the firmware was made; and it changes each field of the header
alone, the limits in its comments too, with every hash that speaks of it corrected. Records for
later commands are damaged only. Each time it runs `zerodrift verify`: reported is exit code 1 or 2
without a traceback. Exit code 1 if something was not reported.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from benchmarks.mutants.judge import replace_file
from benchmarks.mutants.subjects import PROJECTS, train_project
from zerodrift.verify.replay import RECORDS

ROOT = Path(__file__).parents[2] / "build" / "sabotage"
FOLDERS = ("firmware", "build")
SECONDS = 600


@dataclass(frozen=True)
class Deed:
    """One thing to spoil."""

    what: str
    do: Callable[[Path], None]
    """Given the directory of a project of its own."""


@dataclass(frozen=True)
class Told:
    """What `zerodrift verify` said of it."""

    what: str
    code: int
    text: str

    @property
    def reported(self) -> bool:
        """Whether it failed in the way that a command fails."""
        return self.code in (1, 2) and "Traceback" not in self.text


def list_deeds(project: Path, other: Path) -> Iterator[Deed]:
    """Yield all that is done to a project; `other` is one with another model."""
    for folder in FOLDERS:
        for path in sorted((project / folder).iterdir()):
            name = path.relative_to(project)
            if path.is_file() and not path.name.startswith("."):
                deeds = list_file_deeds(name, project, other)
                yield from (d for d in deeds if path.name not in RECORDS or is_damage(d))
    for log in ("logs/train_1.csv", "logs/test_1.csv"):
        yield Deed(f"{log}: one digit changed", lambda at, log=log: _change_digit(at / log))
    yield Deed("zerodrift.toml: full_scale changed", _change_full_scale)
    header = next((project / "firmware").glob("[!z]*.h")).relative_to(project)
    for what, text in list_header_changes((project / header).read_text(encoding="utf-8")):
        yield Deed(
            f"{header}: {what}",
            lambda at, text=text: replace_file(
                at / header, text.encode(), [at / folder for folder in FOLDERS]
            ),
        )


def is_damage(deed: Deed) -> bool:
    """Tell whether a deed damages a file: a record may be gone, or of another training."""
    return not deed.what.endswith(("deleted", "that of another model"))


def list_file_deeds(name: Path, project: Path, other: Path) -> Iterator[Deed]:
    """Yield what is done to one file."""
    yield Deed(f"{name}: deleted", lambda at: (at / name).unlink())

    def rewrite(at: Path, change: Callable[[bytes], bytes]) -> None:
        (at / name).write_bytes(change((at / name).read_bytes()))

    def flip(data: bytes) -> bytes:
        middle = len(data) // 2
        return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]

    yield Deed(f"{name}: cut in half", lambda at: rewrite(at, lambda d: d[: len(d) // 2]))
    yield Deed(f"{name}: one bit of one byte flipped", lambda at: rewrite(at, flip))
    yield Deed(f"{name}: emptied", lambda at: rewrite(at, lambda _: b""))
    if name.suffix in (".c", ".h"):
        yield Deed(
            f"{name}: made uncompilable", lambda at: rewrite(at, lambda d: b"#error no\n" + d)
        )
    theirs = (other / name).read_bytes() if (other / name).is_file() else b""
    if theirs and theirs != (project / name).read_bytes():
        yield Deed(f"{name}: that of another model", lambda at: (at / name).write_bytes(theirs))


def list_header_changes(text: str) -> Iterator[tuple[str, str]]:
    """Yield each field of a header changed alone: macros, and limits that stand in comments."""
    for match in re.finditer(r'(?m)^#define (\w+) (?:U?INT\d+_C\()?(-?\d+|"\w+")', text):
        old = match[2]
        new = f'"{"0" if old[1] != "0" else "1"}{old[2:]}' if old[0] == '"' else str(int(old) + 1)
        yield f"{match[1]} {old} -> {new}", text[: match.start(2)] + new + text[match.end(2) :]
    for match in re.finditer(r"-?\d+(?:\.\d+)?(?= (?:\.\. -?\d+|counts|degC per count))", text):
        new = f"{match[0]}1" if "." in match[0] else str(int(match[0]) + 1)
        line = text[text.rfind("\n", 0, match.start()) + 1 :].split("\n", 1)[0].strip()
        changed = text[: match.start()] + new + text[match.end() :]
        yield f"{match[0]} -> {new} in the comment of {line:.50}", changed


def _change_digit(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    at = text.index(".", len(text) // 2) + 1
    path.write_text(text[:at] + str((int(text[at]) + 1) % 10) + text[at + 1 :], encoding="utf-8")


def _change_full_scale(at: Path) -> None:
    path = at / "zerodrift.toml"
    path.write_text(path.read_text().replace("full_scale = 2000", "full_scale = 1000"))


def run_deed(project: Path, deed: Deed) -> Told:
    """Do it to a copy of the project and run `zerodrift verify` there."""
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "project"
        shutil.copytree(project, copy)
        deed.do(copy)
        command = [sys.executable, "-m", "zerodrift", "verify", "-C", str(copy), "--trust"]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=SECONDS, check=False
            )
        except subprocess.TimeoutExpired:
            return Told(deed.what, -1, f"no end in {SECONDS} s")
    return Told(deed.what, done.returncode, (done.stdout + done.stderr).replace(name, ""))


def main(quick: bool = False, project_name: str = "gru", jobs: int = 2) -> int:
    """Print what was reported; return 1 if something was not."""
    project = train_project(project_name, ROOT / project_name)
    other_name = next(name for name in PROJECTS if name != project_name)
    other = train_project(other_name, ROOT / other_name)
    unspoilt = run_deed(project, Deed("nothing", lambda _: None))
    if unspoilt.code != 0:
        raise SystemExit(f"verify fails on the unspoilt project:\n{unspoilt.text}")
    deeds = list(list_deeds(project, other))[:: 7 if quick else 1]
    with ThreadPoolExecutor(jobs) as pool:
        reported = 0
        for one in pool.map(lambda deed: run_deed(project, deed), deeds):
            reported += one.reported
            word = "reported" if one.reported else "NOT REPORTED"
            said = " ".join(one.text.split())[-160:]
            print(f"{word} {one.what}: exit code {one.code}: {said}", flush=True)
    print(f"sabotage: {reported} of {len(deeds)} reported")
    return int(reported < len(deeds))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sabotage", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="every seventh")
    parser.add_argument("--project", choices=list(PROJECTS), default="gru")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    sys.exit(main(given.quick, given.project, given.jobs))
