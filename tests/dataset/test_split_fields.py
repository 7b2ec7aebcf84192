"""Fields of a line: the quick way must find what the csv module finds."""

import csv
import random

import pytest

from zerodrift.dataset.text_format import DELIMITERS, SPACES, _count_fields, split_fields

PARTS = ("1.5", "-3", "a b", '"', "\r", "\0", " ", "", "12:30", "é", *DELIMITERS)


def split_by_csv(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


@pytest.mark.parametrize("separator", [each for each in DELIMITERS if each != SPACES])
def test_split_fields_equals_the_csv_module(separator: str) -> None:
    rng = random.Random(20261124)
    lines = ["".join(rng.choices(PARTS, k=rng.randrange(20))) for _ in range(4000)]
    lines += ["x" * (csv.field_size_limit() + extra) + separator for extra in (-1, 0, 1)]
    assert any('"' in line for line in lines)
    assert any("\r" in line for line in lines)
    for line in lines:
        expected = split_by_csv(line, separator)
        assert split_fields(line, separator) == expected, line
        assert _count_fields(line, separator) == len(expected), line


def test_split_fields_joins_a_date_and_its_time_between_spaces() -> None:
    assert split_fields("2024-01-02 10:11  3.5", SPACES) == ["2024-01-02T10:11", "3.5"]
    assert split_fields("  1   2\t3 ", SPACES) == ["1", "2", "3"]
