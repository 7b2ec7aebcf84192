"""The folders are the way of the data: each imports only from those before it."""

import ast
import subprocess
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "src" / "zerodrift"
LINKED = ("train", "export", "codegen", "c_runtime")
"""The stages at the root, which `src/zerodrift` holds as links."""
ORDER = (
    *("base", "dataset", "operations", "physics", "calibration", "diagnosis", "train", "export"),
    *("blocks", "codegen", "c_runtime", "verify", "discovery", "recording", "field", "fleet"),
    *("report", "tasks", "workbench", "api", "cli"),
)
FOLDERS = {
    path.name: path.resolve() for path in SOURCE.iterdir() if (path / "__init__.py").is_file()
}


def list_modules() -> dict[str, Path]:
    """Return every module of the product by its dotted name."""
    found = {}
    for stage, folder in FOLDERS.items():
        for path in folder.rglob("*.py"):
            parts = path.relative_to(folder).with_suffix("").parts
            found[".".join(("zerodrift", stage, *(p for p in parts if p != "__init__")))] = path
    return found


MODULES = list_modules()


def list_imports(path: Path) -> Iterator[tuple[str, int]]:
    """Yield each imported module of zerodrift and the line, imports within functions too."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else node.module for name in inner]
        else:
            continue
        for name in names:
            if name.startswith("zerodrift."):
                yield name, node.lineno


def test_every_folder_has_its_place_in_the_order() -> None:
    assert set(FOLDERS) == set(ORDER)


def test_no_import_climbs() -> None:
    climbing = [
        f"{path.relative_to(ROOT)}:{line}: {imported}"
        for name, path in MODULES.items()
        for imported, line in list_imports(path)
        if ORDER.index(imported.split(".")[1]) > ORDER.index(name.split(".")[1])
    ]
    assert not climbing


def test_no_import_goes_in_a_circle() -> None:
    graph = {
        name: {imported for imported, _ in list_imports(path) if imported in MODULES} - {name}
        for name, path in MODULES.items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_links_lead_to_the_four_stages_and_nowhere_else() -> None:
    links = {path: path.readlink() for path in SOURCE.rglob("*") if path.is_symlink()}
    assert links == {SOURCE / name: Path("../..") / name for name in LINKED}
    assert not [path for name in LINKED for path in (ROOT / name).rglob("*") if path.is_symlink()]


ROOMS = {".ci", "docs", "examples", "lab", "proof", "src", "tests", *LINKED}
"""Folders at the root: nothing else holds code."""


def test_the_root_holds_only_what_it_is_to() -> None:
    listed = subprocess.run(
        ("git", "ls-files"), cwd=ROOT, capture_output=True, text=True, check=True
    )
    entries = {name.partition("/")[0] for name in listed.stdout.splitlines() if "/" in name}
    assert entries == ROOMS
