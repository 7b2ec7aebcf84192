"""The names by which a caller reads the drift: no certificate vouches for one beside the array."""

from pathlib import Path

import pytest

from zerodrift.verify.c_header import find_wrong_indices

HEADER = (Path(__file__).parents[1] / "golden" / "front_end.h").read_text()


def test_a_header_as_it_is_made_has_every_place_once() -> None:
    assert find_wrong_indices(HEADER, "front_end") == []


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("FRONT_END_FY 1 ", "FRONT_END_FY 2 "),
        ("FRONT_END_FZ 2 ", "FRONT_END_FZ 3 "),
        ("FRONT_END_FX 0 ", "FRONT_END_FX -5 "),
        ("FRONT_END_FX 0 ", "FRONT_END_FX 00 "),
        ("FRONT_END_FX 0 ", "FRONT_END_FX (0) "),
        ("#define FRONT_END_FX 0 ", "/* gone */ "),
        ("FRONT_END_OUTPUTS 3", "FRONT_END_OUTPUTS 2"),
        ("FRONT_END_OUTPUTS 3", "FRONT_END_OUTPUTS 4"),
        ("FRONT_END_OUTPUTS 3", "FRONT_END_OUTPUTS 3u"),
        ("#define FRONT_END_FX 0 ", "#define FRONT_END_FX 0\n#  define  FRONT_END_FX 7 "),
    ],
)
def test_a_place_beside_the_array_is_a_failure(before: str, after: str) -> None:
    assert HEADER.count(before) == 1
    assert find_wrong_indices(HEADER.replace(before, after), "front_end")
