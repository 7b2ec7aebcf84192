"""The count of lines leaves out nothing that is written, and no folder is above its ceiling."""

import pytest
from tests.house.lines import ROOT, add_up, count_lines, name_folder, read_ceilings


@pytest.mark.parametrize(
    ("file", "folder"),
    [
        ("src/zerodrift/operations/gru/cell.py", "src/zerodrift/operations"),
        ("src/zerodrift/__init__.py", "src/zerodrift"),
        ("train/gru/cell.py", "train"),
        ("lab/zerodrift_lab/twin/heat.py", "lab/zerodrift_lab"),
        ("lab/benchmarks/float_gru.c", "lab/benchmarks"),
        ("tests/lab/test_twin.py", "tests"),
        ("proof/zerodrift_proof/bound/check.py", "proof"),
        ("setup.py", "."),
    ],
)
def test_a_file_belongs_to_one_folder(file: str, folder: str) -> None:
    assert name_folder(file) == folder


def test_written_files_are_counted_and_stored_ones_are_not() -> None:
    lines = count_lines()
    file = "src/zerodrift/operations/gru/cell.py"
    assert lines[file] == len((ROOT / file).read_text("utf-8").splitlines())
    assert "src/zerodrift/workbench/assets/workbench.js" in lines
    assert not [f for f in lines if f.startswith("tests/golden/") or "/stored/" in f]


def test_sums_hold_what_their_folders_hold() -> None:
    told = add_up({"train/a.py": 3, "src/zerodrift/base/b.py": 4, "train/c.j2": 2, "tests/d.py": 9})
    assert told["core"] == (9, 2)
    assert told["train"] == (5, 1)


def test_no_folder_is_above_its_ceiling() -> None:
    """Else make room first, or write the decision that says what the rise buys."""
    ceilings = read_ceilings()
    found = add_up(count_lines())
    assert not set(found) - set(ceilings), "folders without a ceiling"
    above = {
        name: f"{lines} lines of {ceilings[name][0]}, {modules} modules of {ceilings[name][1]}"
        for name, (lines, modules) in found.items()
        if lines > ceilings[name][0] or modules > ceilings[name][1]
    }
    assert not above
