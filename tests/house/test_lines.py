"""The count of lines leaves out nothing that is written and counts nothing that is stored."""

import pytest
from tests.house.lines import ROOT, count_lines, name_part


@pytest.mark.parametrize(
    ("file", "part"),
    [
        ("src/zerodrift/operations/gru/cell.py", "product"),
        ("src/zerodrift/cli/main.py", "product"),
        ("src/zerodrift/__init__.py", "product"),
        ("lab/zerodrift_lab/twin/heat.py", "laboratory"),
        ("tests/lab/test_twin.py", "tests"),
        ("lab/benchmarks/float_gru.c", "benchmarks"),
        ("laboratory.py", "others"),
    ],
)
def test_a_file_belongs_to_one_part(file, part) -> None:
    assert name_part(file) == part


def test_written_files_are_counted_without_their_empty_lines() -> None:
    lines = count_lines()
    file = "src/zerodrift/operations/gru/cell.py"
    text = (ROOT / file).read_text("utf-8")
    assert lines[file] == len(text.splitlines()) - text.splitlines().count("")
    assert "src/zerodrift/workbench/assets/workbench.js" in lines
    assert not [f for f in lines if f.startswith("tests/golden/") or "/stored/" in f]
