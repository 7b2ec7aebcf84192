"""Keeps the last answer of a function that takes long and is asked the same thing again."""

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

Asked = TypeVar("Asked")
Told = TypeVar("Told")


def remember_last(compute: Callable[[Asked], Told]) -> Callable[[Asked], Told]:
    """Return the function with a memory of the object that it was last asked about.

    The same object gets the same answer, without a computation; nothing is kept longer than that
    object lives. It is for frozen arguments whose answer nobody writes to.
    """
    known: list[tuple[weakref.ref[object], Told]] = []

    @wraps(compute)
    def recall(asked: Asked) -> Told:
        for whose, told in known:
            if whose() is asked:
                return told
        told = compute(asked)
        known[:] = [(weakref.ref(asked, lambda _: known.clear()), told)]
        return told

    return recall
