"""The comparing of `tests.house.same_as`; the whole of it is a program of its own."""

import pytest
from tests.house.same_as import (
    EXEMPT,
    Outcome,
    Step,
    compare_files,
    compare_outcomes,
    compare_project,
    compare_values,
)

TOLD = '{"rmse": {"Fz": 0.5}, "runs": [1, 2], "name": "lag", "cpu_s": 1.0}'
SAME = Outcome(0, TOLD, "", {"firmware/cell.c": b"int a = 1;\n", "build/x.npz": b"\xff\x00"})


def change(**changes: object) -> Outcome:
    return Outcome(**{**vars(SAME), **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "new",
    [
        '{"name": "lag", "cpu_s": 7.0, "runs": [1, 2], "rmse": {"Fz": 0.5}}',
        TOLD.replace("0.5", "0.50000000000001"),
        TOLD.replace("[1, 2]", "[1.0, 2]"),
    ],
)
def test_what_is_the_same(new: str) -> None:
    assert compare_outcomes(SAME, change(out=new)) is None


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"code": 2}, "exit code 0 is now 2"),
        ({"err": "note: more\n"}, "stderr: line 1"),
        ({"out": TOLD.replace("0.5", "0.500000001")}, "rmse.Fz: '0.5' is now"),
        ({"out": TOLD.replace("Fz", "fz")}, "rmse.Fz is gone"),
        ({"out": TOLD.replace("[1, 2]", "[2, 1]")}, "runs[0]: '1' is now '2'"),
        ({"out": TOLD.replace("[1, 2]", "[1, 2, 3]")}, "runs has 2 items, now 3"),
        ({"out": TOLD.replace("[1, 2]", "[true, 2]")}, "runs[0]"),
        ({"out": TOLD.replace('"lag"', "null")}, "name: 'lag' is now 'None'"),
        ({"out": TOLD[:-1] + ', "more": 1}'}, "more is new"),
        ({"out": "text"}, "line 1"),
        ({"files": {}}, "build/x.npz: written by the old tree alone"),
        ({"files": {**SAME.files, "a": b""}}, "a: written by the new tree alone"),
        ({"files": {**SAME.files, "build/x.npz": None}}, "removed by the new tree alone"),
        ({"files": {**SAME.files, "build/x.npz": b"\xff\x01"}}, "differ at byte 1"),
        ({"files": {**SAME.files, "firmware/cell.c": b"int a = 2;\n"}}, "firmware/cell.c: line 1"),
    ],
)
def test_a_difference_is_told(changes: dict[str, object], told: str) -> None:
    found = compare_outcomes(SAME, change(**changes))
    assert found is not None and told in found


def test_files_of_the_firmware_are_compared_byte_for_byte() -> None:
    old, new = b'{"a": 1, "b": 2}', b'{"b": 2, "a": 1}'
    assert compare_files("build/history.json", old, new) is None
    for path in ("firmware/effects.json", "build/model.json", "build/certificate.json"):
        assert compare_files(path, old, new) is not None


def test_a_number_near_zero_is_held_against_its_own_size() -> None:
    assert compare_values(1e-12, 2e-12) is not None
    assert compare_values(float("nan"), float("nan")) is None


def test_a_command_that_fails_unexpectedly_in_both_trees_is_told() -> None:
    broken = change(code=2, err="error: no such option\n")
    (row,) = compare_project("physics", (Step(("compare",)),), [broken], [broken])
    assert row.difference == "exit code 2, expected 0: error: no such option"


def test_every_exemption_has_a_reason() -> None:
    assert all(EXEMPT.values())
    assert compare_values({"cpu_s": 1}, {"cpu_s": 2}) is None
    assert compare_values({"cpu_s": 1}, {}) is not None
