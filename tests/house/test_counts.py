"""What the types do not see may only become less."""

import pytest
from tests.house import counts

MOST_SUBSCRIPTS = 0
MOST_ANY = 5
"""Lower them with the counts: `python -m tests.house.counts --short`."""


@pytest.mark.parametrize(
    ("find", "most"),
    [(counts.list_subscripts, MOST_SUBSCRIPTS), (counts.list_any, MOST_ANY)],
    ids=["string subscripts", "Any"],
)
def test_counts_only_fall(find, most) -> None:
    places = find()
    assert len(places) <= most, "\n".join(f"{p.file}:{p.line}: {p.text}" for p in places)


def test_no_two_classes_share_a_name() -> None:
    shared = {name: files for name, files in counts.list_classes().items() if len(files) > 1}
    assert not shared


def test_any_is_left_for_a_reason_alone() -> None:
    assert {place.file for place in counts.list_any()} == set(counts.KEPT_ANY)


def test_what_is_left_out_of_the_count_is_there() -> None:
    assert all(any(counts.ROOT.glob(file)) for file in counts.EDGES)
