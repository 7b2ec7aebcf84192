"""Answers that are kept for as long as what they were asked about."""

import gc

from zerodrift.base.remember import remember_last


class Asked:
    """Something that can be told apart from its equals."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Asked)

    def __hash__(self) -> int:
        return 1


def test_answer_is_computed_once_for_an_object_and_anew_for_its_equal():
    calls = []
    ask = remember_last(lambda asked: calls.append(asked) or len(calls))
    one, other = Asked(), Asked()
    assert [ask(one), ask(one), ask(other), ask(other), ask(one)] == [1, 1, 2, 2, 3]


def test_nothing_is_kept_longer_than_what_was_asked_about():
    told = Asked()
    ask = remember_last(lambda asked: [told])
    one = Asked()
    before = len(gc.get_referrers(told))
    ask(one)
    del one
    gc.collect()
    assert len(gc.get_referrers(told)) == before
