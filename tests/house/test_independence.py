"""The checkers stand alone: on the standard library, and each reads C by code of its own."""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest
from tests.house.test_order import MODULES, ROOT

PROOF = ROOT / "proof"
FACE = "zerodrift_proof"
"""What others may import; the modules inside are the checkers' own."""


def list_checkers() -> dict[str, Path]:
    """Return every module of the checkers by its dotted name."""
    found = {}
    for path in (PROOF / FACE).rglob("*.py"):
        parts = path.relative_to(PROOF).with_suffix("").parts
        found[".".join(p for p in parts if p != "__init__")] = path
    return found


CHECKERS = list_checkers()
FIRST, SECOND = [
    tuple(f"{FACE}.{room}." for room in rooms)
    for rooms in (("certificate", "bound"), ("equality", "object"))
]
APART = {**dict.fromkeys(FIRST, SECOND), **dict.fromkeys(SECOND, FIRST)}
"""Modules whose names begin so -> those that they must not reach, which read C too."""
TESTERS = ("bench_object_proof.py", "object_oracle.py")
"""Of lab/benchmarks: they plant faults in what a module inside is given, as tests do."""


@cache
def list_imports(path: Path) -> list[str]:
    """Return each module that a file imports, within functions too."""
    found: list[str] = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.module and not node.level, f"{path}:{node.lineno}"
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            found += (name if name in CHECKERS else node.module for name in inner)
    return found


def reach(name: str) -> set[str]:
    """Return a checker and all of the checkers' modules that it imports, directly or not."""
    found, open_ = set(), {name}
    while open_:
        one = open_.pop()
        found.add(one)
        open_ |= {n for n in list_imports(CHECKERS[one]) if n in CHECKERS} - found
    return found


@pytest.mark.parametrize("begin", APART)
def test_each_reads_c_by_its_own_code(begin: str) -> None:
    modules = [name for name in CHECKERS if name.startswith(begin)]
    assert modules
    for name in modules:
        others = sorted(n for n in reach(name) if n.startswith(APART[begin]))
        assert not others, f"{name} reaches {others}"


def test_the_checkers_import_nothing_but_the_standard_library() -> None:
    allowed = {*sys.stdlib_module_names, FACE}
    for path in CHECKERS.values():
        foreign = {n for n in list_imports(path) if n.partition(".")[0] not in allowed}
        assert not foreign, f"{path} imports {foreign}"


def test_the_checkers_face_alone_is_imported_and_in_one_place() -> None:
    lab = [p for p in (ROOT / "lab").rglob("*.py") if p.name not in TESTERS]
    files = {**MODULES, **{str(p): p for p in lab}}
    inside = {
        name: sorted(n for n in list_imports(path) if n.startswith(f"{FACE}."))
        for name, path in files.items()
    }
    assert not {name: found for name, found in inside.items() if found}
    users = [name for name, path in MODULES.items() if FACE in list_imports(path)]
    assert users == ["zerodrift.verify.checkers"]
