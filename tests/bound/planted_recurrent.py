"""Unsound rules of a GRU's error, and layers on which each of them shows."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Protocol

from zerodrift.operations.errors import NONE, Error
from zerodrift.operations.gru import error
from zerodrift.operations.tables import SigmoidError

ZERO = Fraction(0)


class Patch(Protocol):
    """What replaces an attribute while a test runs."""

    def setattr(self, target: object, name: str, value: object) -> None:
        """Replace one."""


def _patch(target: object, name: str, value: object) -> Callable[[Patch], None]:
    return lambda patch: patch.setattr(target, name, value)


def _change_growth(change: Callable[[error.Growth], error.Growth]) -> Callable[[Patch], None]:
    right = error._Rules.bound_growth
    return _patch(error._Rules, "bound_growth", lambda rules, i: change(right(rules, i)))


def _no_gains(growth: error.Growth) -> error.Growth:
    return replace(growth, gains=(ZERO,) * len(growth.gains))


def _no_update_gains(growth: error.Growth) -> error.Growth:
    update = replace(growth.update, gains=(ZERO,) * len(growth.gains))
    return replace(growth, update=update)


def _halved(states: list[Error]) -> list[Error]:
    return [state.scale(Fraction(1, 2)) for state in states]


def _perfect_reset(rules: error._Rules, i: int) -> tuple[Fraction, error.GateArgument]:
    most, r = _right_reset(rules, i)
    return most, replace(r, error=NONE)


_right_reset = error._Rules._bound_reset
_right_solve, _right_slope, _right_table = (
    error._solve,
    error.bound_slope,
    error.bound_sigmoid_table,
)

RULES: dict[str, Callable[[Patch], None]] = {
    "table of tanh": _patch(error, "bound_tanh", lambda: ZERO),
    "table of the sigmoid": _patch(
        error, "bound_sigmoid_table", lambda low, high: SigmoidError(ZERO, ZERO)
    ),
    "table of the sigmoid, near 0": _patch(
        error, "bound_sigmoid_table", lambda low, high: _right_table(0, high)
    ),
    "features": _patch(error._Rules, "_sum_features", lambda rules, *given: NONE),
    "states": _patch(error._Rules, "_sum_states", lambda rules, *given: NONE),
    "update gate": _change_growth(
        lambda growth: replace(growth, update=replace(growth.update, error=NONE))
    ),
    "where N and H lie": _change_growth(lambda growth: replace(growth, half=growth.half / 8)),
    "reset gate": _patch(error._Rules, "_bound_reset", _perfect_reset),
    "candidate": _change_growth(lambda growth: replace(growth, fixed=NONE)),
    "what states pass on": _change_growth(_no_gains),
    "what states pass on to the update gate": _change_growth(_no_update_gains),
    "slope of tanh": _patch(error, "bound_slope", lambda low, high: _right_slope(low, high) / 8),
    "half": _patch(error, "_solve", lambda growths: _halved(_right_solve(growths))),
}

FOUND = (
    ("table of tanh", "alone"),
    ("candidate", "alone"),
    ("half", "alone"),
    ("table of the sigmoid", "slow"),
    ("table of the sigmoid, near 0", "slow"),
    ("where N and H lie", "slow"),
    ("where N and H lie", "passed to u"),
    ("states", "states"),
    ("slope of tanh", "states"),
    ("half", "states"),
    ("states", "update"),
    ("update gate", "update"),
    ("states", "reset"),
    ("reset gate", "reset"),
    ("half", "reset"),
    ("features", "passed on"),
    ("what states pass on", "passed on"),
    ("slope of tanh", "passed on"),
    ("features", "passed to u"),
    ("what states pass on to the update gate", "passed to u"),
)
"""What is left out, and the probe on which an input goes beyond what is then claimed."""
