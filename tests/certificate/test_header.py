"""The names by which a caller reads the drift: no certificate vouches for one beside the array."""

import pytest

from tests.certificate.refused import FILES, NAME, H
from zerodrift_proof.certificate.check import find_wrong_indices
from zerodrift_proof.certificate.preprocessor import WordSpots, read_header


def find(header: str) -> list[str]:
    return find_wrong_indices(read_header(header, NAME, WordSpots()).macros, NAME)


def test_a_header_as_it_is_made_has_every_place_once() -> None:
    assert find(FILES[H]) == []


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("FRONT_END_FY 1 ", "FRONT_END_FY 2 "),
        ("FRONT_END_FZ 2 ", "FRONT_END_FZ 3 "),
        ("FRONT_END_FX 0 ", "FRONT_END_FX 4294967291 "),
        ("FRONT_END_OUTPUTS 3", "FRONT_END_OUTPUTS 2"),
        ("FRONT_END_OUTPUTS 3", "FRONT_END_OUTPUTS 4"),
        ("FRONT_END_OUTPUTS 3", "FRONT_END_OUTPUTS 0"),
        (
            "#define FRONT_END_FX 0 /* Fx in N, -1000000 .. 750000 counts */\n"
            "#define FRONT_END_FX_LSB_PER_UNIT 1\n",
            "",
        ),
    ],
)
def test_a_place_beside_the_array_is_a_failure(before: str, after: str) -> None:
    assert FILES[H].count(before) == 1
    assert find(FILES[H].replace(before, after))


def test_a_definition_in_a_comment_is_none() -> None:
    header = FILES[H].replace(
        "#define FRONT_END_FX 0 ", "/* #define FRONT_END_FX 0 */\n#define FRONT_END_FX 7 "
    )
    assert find(header)
