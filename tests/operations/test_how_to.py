"""The page on how to write an operation says what the code does, and what it needs."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

import pytest

from zerodrift import operations
from zerodrift.codegen.generate import make_environment
from zerodrift.operations import registry
from zerodrift.operations.node import IntegerNode
from zerodrift_proof.equality import operations as meanings
from zerodrift_proof.equality.node import Node

PAGE = Path(__file__).parents[2] / "docs/how-to/write-an-operation.md"
HOME = "src/zerodrift/operations"
PROOF = "proof/zerodrift_proof/equality/operations"
FILE = re.compile(r"^`([\w/]+\.\w+)`:\n\n```\w+\n(.*?)^```$", re.M | re.S)
KNOWN = ("OPERATIONS", "NODE_CLASSES", "FOLDERS", "FILTERS")
STATELESS, STATEFUL = 4, 5
"""Files at most: the folder's, the meaning for the proof, a rule of the checker's, and a test."""


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """Give the page's files, with their folders found beside the product's own."""
    texts = dict(FILE.findall(PAGE.read_text(encoding="utf-8")))
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    own = [str(tmp_path / HOME), *operations.__path__]
    monkeypatch.setattr(operations, "__path__", own)
    before = {name: dict(getattr(registry, name)) for name in KNOWN}
    registry.find_operations()
    monkeypatch.setattr(meanings, "__path__", [str(tmp_path / PROOF), *meanings.__path__])
    known = dict(meanings.KINDS)
    meanings.find_operations()
    make_environment.cache_clear()
    yield texts
    make_environment.cache_clear()
    for name in KNOWN:
        table = getattr(registry, name)
        table.clear()
        table.update(before[name])
    for folder in {name.split("/")[3] for name in texts if name.startswith(HOME)}:
        del sys.modules[f"{operations.__name__}.{folder}"]
    for kind in meanings.KINDS.keys() - known.keys():
        del meanings.KINDS[kind], sys.modules[f"{meanings.__name__}.{kind}"]


def test_the_page_s_operations_are_the_same_everywhere(
    files: dict[str, str], tmp_path: Path
) -> None:
    (test,) = (text for name, text in files.items() if name.startswith("tests/"))
    names: dict[str, FunctionType] = {}
    exec(compile(test, str(PAGE), "exec"), names)
    (check,) = (f for name, f in names.items() if name.startswith("test_"))
    check(tmp_path)


def test_an_operation_is_no_more_files_than_the_page_says(files: dict[str, str]) -> None:
    shared = 3  # the test, the meaning for the proof, and a rule of the checker's
    folders = [name.split("/")[3] for name in files if name.startswith(HOME)]
    for folder in set(folders):
        stateful = registry.NODE_CLASSES[folder].rest is not IntegerNode.rest
        assert folders.count(folder) + shared == (STATEFUL if stateful else STATELESS)
        assert f"{PROOF}/{folder}.py" in files
    for name in ("maximum", "minimum"):
        own = [p for p in (PAGE.parents[2] / HOME / name).iterdir() if p.is_file()]
        assert len(own) + shared == STATELESS


def test_the_page_names_every_face() -> None:
    page = PAGE.read_text(encoding="utf-8")
    own = {name for name in vars(Node) if not name.startswith("_")}
    for name in own - {"reads_drift", "numbered", "streams", "give_at_rest"}:
        assert f"`{name}`" in page, name
    faces = {name for name in vars(IntegerNode) if not name.startswith("_")}
    for name in faces - {"attributes", "width", "stateful", "reads_drift", "idle", "elapse"}:
        assert f"`{name}`" in page, name
