"""CONTRIBUTING lists every place where a step of a GRU is computed, with the reason of each."""

import ast
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
Place = tuple[str, str]
ROW = re.compile(r"^\| `([^`]+)` \| (`[^|]+`) \|", re.M)
KERNEL = re.compile(r"^(?:static )?(?:inline )?void (zd_(?:gru|lstm)_step\w*)\(", re.M)
ASSEMBLY = re.compile(r"{% macro (\w+)\((?:node|lstm, name)\) %}(?:(?!endmacro).)*naked", re.S)
MOST_ROWS = 8
"""Places outside the kernels; lower it with the table."""
NO_STEP = {
    ("lab/benchmarks/bench_cores.py", "print_table_errors"),
    ("lab/benchmarks/bench_kernels.py", "print_table_errors"),
    ("tests/fixed_point/test_kernels.py", "test_activations_equal_reference_at_the_ends_of_int32"),
    ("tests/fixed_point/test_kernels.py", "test_tanh_error_is_within_the_specified_limit"),
    (
        "tests/fixed_point/test_kernels.py",
        "test_reference_activations_are_odd_complementary_and_saturating",
    ),
    # the error rule of a dense layer, and how far its table is from tanh
    ("src/zerodrift/operations/intervals.py", "enclose_log"),
    ("src/zerodrift/operations/tables.py", "bound_tanh"),
    (
        "tests/bound/test_error_bound.py",
        "test_the_table_of_tanh_is_as_far_from_tanh_as_is_claimed_and_no_further",
    ),
    ("src/zerodrift/operations/dense/__init__.py", "bound_error"),
    # candidates of a minGRU, one or the other
    ("tests/onnx/min_grus.py", "bound"),
    # units of a lag bank, without a gate
    ("tests/train/test_lag_bank.py", "test_slopes_of_the_projection_are_those_of_the_cost"),
    ("tests/train/test_unit_choice.py", "bend"),
    ("train/lag_bank/units.py", "fit_member"),
    # a rule over a tree of the C's text
    ("proof/zerodrift_proof/certificate/armv6m.py", "write_gru"),
    ("proof/zerodrift_proof/certificate/armv6m.py", "write_gru_before"),
    ("proof/zerodrift_proof/certificate/armv6m.py", "write_lstm"),
}
"""Functions with two activations that are no step."""


def read_table() -> set[Place]:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    part = text.split("## Where a step of a GRU is computed")[1].split("\n## ")[0]
    return {(path, name) for path, cell in ROW.findall(part) for name in re.findall(r"\w+", cell)}


def count_rows() -> int:
    """Return how many places of the first table, kernels apart, compute a step of a GRU."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    return len(ROW.findall(text.split("## Where a step of a GRU is computed")[1].split("\n\n")[2]))


def list_calls(function: ast.FunctionDef) -> list[str]:
    called = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
    return [getattr(f, "id", getattr(f, "attr", "")) for f in called]


def find_steps(path: str, text: str) -> set[Place]:
    """Return the functions of a file that look like a step: a sigmoid's and a tanh's, or two."""
    if not path.endswith(".py"):
        return {(path, name) for find in (KERNEL, ASSEMBLY) for name in find.findall(text)}
    found: set[Place] = set()
    for node in ast.walk(ast.parse(text)) if "tanh" in text else ():
        if isinstance(node, ast.FunctionDef):
            calls = list_calls(node)
            bends = sum("tanh" in name for name in calls)
            if bends > 1 or (bends and any("sigmoid" in name for name in calls)):
                found.add((path, node.name))
    return found


def test_every_step_of_a_gru_stands_in_the_table() -> None:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.split()
    found: set[Place] = set()
    for path in listed:
        if path.endswith((".py", ".h", ".c", ".j2")) and "/stored/" not in path:
            found |= find_steps(path, (ROOT / path).read_text(encoding="utf-8"))
    table = read_table()
    assert found - NO_STEP <= table
    assert found >= NO_STEP  # nothing stands there without need
    assert len(found & table) >= 12  # the search finds most of them
    assert 0 < count_rows() <= MOST_ROWS
    for path, name in table:
        assert re.search(rf"\b{name}\b", (ROOT / path).read_text(encoding="utf-8")), (path, name)


def test_search_finds_a_step() -> None:
    text = "def walk(w, x, h):\n    u = sigmoid(w @ h)\n    return h + u * (np.tanh(x) - h)\n"
    assert find_steps("train/other.py", text) == {("train/other.py", "walk")}
    kernel = "static inline void zd_gru_step_neon(const int16_t *x) {\n"
    assert find_steps("c_runtime/x.h", kernel) == {("c_runtime/x.h", "zd_gru_step_neon")}
