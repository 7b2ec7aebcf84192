"""One fault at one call: what the command then says and leaves behind."""

import contextlib
import ctypes
import hashlib
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.scenarios import FLEET_REPORT, Scenario, copy_project, find_set

ON_PROJECT, ELSEWHERE, ALLOCATION = range(3)
COUNT, FAIL, KILL = range(3)
SECONDS = 300
MODULES = "modules.txt"
"""Beside the project: names of the modules that were loaded when a command ended."""
_BEGUN = """\
import sys
import polars as pl
part, whole = map(pl.read_parquet, sys.argv[1:])
sys.exit(not part.equals(whole.head(len(part))))
"""
"""In a process of its own: a fork of one that has used Polars hangs."""
Tree = dict[str, str]
"""Path -> hash of the content, or "folder"."""


@dataclass(frozen=True)
class Ended:
    """How a process of the command line ended."""

    code: int
    """Exit code; negative: the signal."""
    said: str
    calls: tuple[str, ...] = ()
    """What was counted, if it was written down."""


@dataclass(frozen=True)
class Point:
    """The n-th call of a kind."""

    where: int
    way: int
    number: int


@dataclass(frozen=True)
class Told:
    """What is wrong at one point; nothing if all is well."""

    point: Point
    call: str
    wrong: tuple[tuple[str, str], ...] = ()
    """(kind, detail) with kind of `KINDS`."""


KINDS = ("traceback", "message", "exit code", "mixed", "stray", "next command", "hang")


def run_command(
    folder: Path, arguments: tuple[str, ...], point: Point | None = None, log: bool = False
) -> Ended:
    """Run zerodrift in a child of this process, which has its modules loaded.

    Args:
        folder: the project; calls on its paths are counted.
        arguments: {} stands for the folder.
        point: where it fails or dies, if anywhere.
        log: write down what is counted.
    """
    output = folder.parent / "said.txt"
    calls = folder.parent / "calls.txt"
    child = os.fork()
    if child == 0:
        code = 70
        try:
            code = _be_the_command(folder, arguments, point, output, calls if log else None)
        finally:
            os._exit(code)
    signal.signal(signal.SIGALRM, lambda *_: os.killpg(child, signal.SIGKILL))
    signal.alarm(SECONDS)
    _, status = os.waitpid(child, 0)
    hung = signal.alarm(0) == 0
    with contextlib.suppress(OSError):
        os.killpg(child, signal.SIGKILL)
    said = output.read_text(errors="replace") if output.exists() else ""
    counted = tuple(calls.read_text().splitlines()) if log else ()
    return Ended(-999 if hung else os.waitstatus_to_exitcode(status), said, counted)


def _be_the_command(
    folder: Path, arguments: tuple[str, ...], point: Point | None, output: Path, calls: Path | None
) -> int:
    """Run the command line in this process; return its exit code."""
    from zerodrift.cli.main import main

    os.setsid()
    said = os.open(output, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(said, stream)
    log = os.open(calls, os.O_CREAT | os.O_WRONLY | os.O_TRUNC) if calls else -1
    os.chdir(folder.parent)
    sys.argv = ["zerodrift", *(a.replace("{}", str(folder)) for a in arguments)]
    if point or calls:
        point = point or Point(ON_PROJECT, COUNT, 0)
        shim = ctypes.CDLL(None)
        shim.zd_fault_arm(
            str(folder).encode(), point.where, point.way, ctypes.c_long(point.number), log
        )
    code = 0
    try:
        main()
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
        if isinstance(ended.code, str):
            print(ended.code, file=sys.stderr)
    except BaseException:  # noqa: BLE001 - the interpreter would print it, and end with 1
        traceback.print_exc()
        code = 1
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        sys.stderr.flush()
    if calls:
        calls.with_name(MODULES).write_text("\n".join(sys.modules))
    return code


def load_modules(listed: Path) -> None:
    """Import what a command had imported when it ended, so that its next children need not."""
    for name in listed.read_text().splitlines():
        if name not in sys.modules:
            with contextlib.suppress(
                Exception
            ):  # a user's effects, which have no place in sys.path
                importlib.import_module(name)


def read_tree(folder: Path) -> Tree:
    """Return all that lies in a project."""
    tree: Tree = {}
    for path in sorted(folder.rglob("*")) if folder.is_dir() else ():
        name = str(path.relative_to(folder))
        tree[name] = _hash(path) if path.is_file() else "folder"
    return tree


def _hash(path: Path) -> str:
    """Return the hash of a file, but for a report's word on what was there already."""
    content = path.read_bytes().replace(b'"kept": true', b'"kept": false')
    return hashlib.sha256(content).hexdigest()


def hash_whole(folder: Path) -> str:
    """Return one hash of every path, kind, mode and content in a project, locks and strays too."""
    whole = hashlib.sha256()
    for path in sorted(folder.rglob("*")):
        content = path.read_bytes() if path.is_file() else b""
        told = (str(path.relative_to(folder)), path.lstat().st_mode, len(content))
        whole.update(repr(told).encode() + content)
    return whole.hexdigest()


def is_hidden(path: str) -> bool:
    """Say whether a path is not shown to a user: journals, locks, what is on its way."""
    return any(part.startswith(".") for part in Path(path).parts)


@dataclass
class Trial:
    """A scenario: the project before, and what it is after a run without faults."""

    scenario: Scenario
    folder: Path
    """A directory of its own; the project is always at the same place in it."""
    old: Tree = field(default_factory=dict)
    new: Tree = field(default_factory=dict)
    varies: set[str] = field(default_factory=set)
    """Files that differ from run to run without any fault."""
    calls: dict[int, tuple[str, ...]] = field(default_factory=dict)
    followed: dict[str, tuple[tuple[str, str], ...]] = field(default_factory=dict)
    """Hash of all that a fault left -> what was wrong when the command was run on it."""

    @property
    def project(self) -> Path:
        """Where the command works."""
        return self.folder / "project"

    @property
    def after(self) -> Path:
        """What a run without faults left."""
        return self.folder / "after"

    def prepare(self) -> None:
        """Make the project, run without faults, four times, and count the calls.

        Raises:
            AssertionError: the command fails without a fault.
        """
        before = self.folder / "before"
        self.project.mkdir(parents=True)
        self.scenario.prepare(self.project, _run_quietly)
        self.project.rename(before)
        self.old = read_tree(before)
        trees = []
        copy_project(before, self.project)
        run_command(self.project, self.scenario.arguments, log=True)
        load_modules(self.folder / MODULES)
        for where in (ON_PROJECT, ELSEWHERE, ALLOCATION):
            copy_project(before, self.project)
            ended = run_command(
                self.project, self.scenario.arguments, Point(where, COUNT, 0), log=True
            )
            assert ended.code == 0, f"{self.scenario.name} without a fault: {ended.said}"
            self.calls[where] = ended.calls
            trees.append(read_tree(self.project))
        copy_project(self.project, self.after)
        self.new = trees[0]
        names = {name for tree in trees for name in tree}
        self.varies = {n for n in names if len({tree.get(n) for tree in trees}) > 1}

    def list_mixed(self, tree: Tree) -> list[str]:
        """Return the sets of files that are neither all old nor all new."""
        sets: dict[str, set[str]] = {}
        for name in {*self.old, *self.new, *tree}:
            visible = {self.old.get(name), self.new.get(name), tree.get(name)} != {"folder", None}
            if name == self.scenario.grows and name in tree and self._is_begun(name):
                continue
            if not is_hidden(name) and name not in self.varies and visible:
                states = sets.setdefault(find_set(name), {"old", "new"})
                if tree.get(name) != self.old.get(name):
                    states.discard("old")
                if tree.get(name) != self.new.get(name):
                    states.discard("new")
        return sorted(name for name, states in sets.items() if not states)

    def _is_begun(self, name: str) -> bool:
        """Say whether a log holds the first rows of the one without faults, bit for bit."""
        paths = [str(folder / name) for folder in (self.project, self.after)]
        return subprocess.run([sys.executable, "-c", _BEGUN, *paths], check=False).returncode == 0

    def try_point(self, point: Point) -> Told:
        """Run with one fault, look, and run again without."""
        copy_project(self.folder / "before", self.project)
        ended = run_command(self.project, self.scenario.arguments, point)
        calls = self.calls[point.where]
        call = calls[point.number - 1].replace(str(self.folder), "") if calls else ""
        is_told = ended.code == 1 and self._tells_of_units()
        wrong = [] if is_told else [*self._judge_end(ended, point)]
        mixed = self.list_mixed(read_tree(self.project))
        if is_told:  # neither old nor new: of the units that went through
            mixed = [name for name in mixed if name != FLEET_REPORT]
        elif mixed or self.scenario.grows:
            run_command(self.project, self.scenario.next_command)  # any command may put it right
            mixed = self.list_mixed(read_tree(self.project))
        wrong += [("mixed", name) for name in mixed]
        state = hash_whole(self.project)
        if state not in self.followed:
            self.followed[state] = tuple(self._follow())
        return Told(point, call, (*wrong, *self.followed[state]))

    def _follow(self) -> Iterator[tuple[str, str]]:
        """Run the command on what a fault left; yield what is wrong then."""
        again = run_command(self.project, self.scenario.arguments)
        if again.code not in self.scenario.codes or "Traceback" in again.said:
            yield "next command", f"exit code {again.code}: {again.said[-200:]}"
            return
        after = read_tree(self.project)
        for name in self.list_mixed(after):
            yield "mixed", f"{name}, after the next run"
        for name in sorted(set(after) - {*self.new, *self.old}):
            yield "stray", name

    def _tells_of_units(self) -> bool:
        """Say whether the report names each failed unit with a cause that somebody foresaw."""
        path = self.project / self.scenario.report
        if not self.scenario.report or not path.is_file():
            return False
        told = [r for r in json.loads(path.read_text())["results"] if r["status"] == "error"]
        causes = [reason for r in told for reason in r["reasons"]]
        return bool(causes) and not any("unforeseen" in cause for cause in causes)

    def _judge_end(self, ended: Ended, point: Point) -> list[tuple[str, str]]:
        """Return what is wrong with how the command ended."""
        tail = ended.said.strip()[-300:]
        if ended.code == -999:
            return [("hang", f"no end in {SECONDS} s")]
        if point.way == KILL:
            return []
        if "Traceback" in ended.said:
            return [("traceback", tail)]
        if ended.code == 0:
            return []  # what it left is looked at anyway
        found = []
        if ended.code != 2:
            found.append(("exit code", f"{ended.code}: {tail}"))
        # where the end of a line of progress could not be written, the message follows in it
        messages = re.findall(r"(?:^|(?<=\w))error: ", ended.said, re.MULTILINE)
        if len(messages) != 1:
            found.append(("message", f"{len(messages)} messages: {tail}"))
        return found


def _run_quietly(project: Path, arguments: tuple[str, ...]) -> int:
    ended = run_command(project, arguments)
    if ended.code != 0:
        print(ended.said, file=sys.stderr)
    return ended.code
