"""Unsound rules of an LSTM's error, and layers on which each of them shows."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction

from tests.bound.planted_recurrent import Patch
from zerodrift.operations.errors import NONE, Error
from zerodrift.operations.lstm import error
from zerodrift.operations.lstm.error import Box, FloatGate, LstmStepError, StepRules
from zerodrift.operations.tables import SigmoidError

ZERO = Fraction(0)


def _patch(target: object, name: str, value: object) -> Callable[[Patch], None]:
    return lambda patch: patch.setattr(target, name, value)


_right_halve, _right_step, _right_solve = error.halve, StepRules.bound_step, error._solve
_right_cell, _right_slope = LstmStepError.grow_cell, error.bound_slope


def _halve_one_side(gates: Sequence[FloatGate], box: Box) -> list[Box]:
    """Leave out the parts on which the first feature is above its middle."""
    middle = sum(box[0]) // 2
    return [part for part in _right_halve(gates, box) if part[0][0] <= middle]


def _change_step(change: Callable[[LstmStepError], LstmStepError]) -> Callable[[Patch], None]:
    return _patch(StepRules, "bound_step", lambda rules, *given: change(_right_step(rules, *given)))


def _halved(states: list[Error]) -> list[Error]:
    return [state.scale(Fraction(1, 2)) for state in states]


RULES: dict[str, Callable[[Patch], None]] = {
    "parts on one side": _patch(error, "halve", _halve_one_side),
    "size of each part": _patch(
        LstmStepError, "grow_cell", lambda part, moved, size: _right_cell(part, moved, part.size)
    ),
    "table of tanh": _patch(error, "bound_tanh", lambda: ZERO),
    "table of the sigmoid": _patch(
        error, "bound_sigmoid_table", lambda low, high: SigmoidError(ZERO, ZERO)
    ),
    "features": _patch(StepRules, "_sum_features", lambda rules, *given: NONE),
    "own": _change_step(lambda step: replace(step, own=NONE)),
    "output gate": _change_step(
        lambda step: replace(step, output=replace(step.output, error=NONE))
    ),
    "slope of tanh": _patch(error, "bound_slope", lambda low, high: _right_slope(low, high) / 8),
    "half": _patch(error, "_solve", lambda growths: _halved(_right_solve(growths))),
}

FOUND = ("parts on one side", "features", "own", "slope of tanh", "half")
"""On the probe an input goes beyond what is then claimed."""
