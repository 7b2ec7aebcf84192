"""Compares a back end with the reference bit for bit and names the first difference."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.export.integer_model import IntegerModel


@dataclass(frozen=True)
class Mismatch:
    """The first place where a back end differs from the reference."""

    step: int
    where: str
    """Output, node or flag, with its index (a GRU's index is the unit)."""
    expected: int
    actual: int
    physical: str = ""
    """Both values in the physical unit, where there is one."""

    def __str__(self) -> str:
        return (
            f"step {self.step}, {self.where}: expected {self.expected}"
            f" (0x{self.expected & 0xFFFFFFFF:08X}), actual {self.actual}"
            f" (0x{self.actual & 0xFFFFFFFF:08X}){self.physical}"
        )


def label_columns(model: IntegerModel) -> list[str]:
    """Return the name of each observed value: nodes in order, vectors with their index."""
    return [
        f"{node.name}[{i}]" if node.width else node.name
        for node in model.nodes
        for i in range(max(node.width, 1))
    ]


def find_mismatch(
    model: IntegerModel,
    expected: NDArray[np.int64],
    actual: NDArray[np.int64],
    labels: list[str],
    first_step: int = 0,
) -> Mismatch | None:
    """Return the earliest difference of two arrays [T, N] of observed values, or None.

    Args:
        model: gives the outputs' units to the columns named drift[k].
        expected: from the reference.
        actual: from the back end.
        labels: [N] names of the columns.
        first_step: number of row 0, for the message.
    """
    differs = expected != actual
    if not differs.any():
        return None
    step = int(differs.any(axis=1).argmax())
    column = int(differs[step].argmax())
    want, got = int(expected[step, column]), int(actual[step, column])
    return Mismatch(
        step=first_step + step,
        where=labels[column],
        expected=want,
        actual=got,
        physical=_describe(model, labels[column], want, got),
    )


def _describe(model: IntegerModel, label: str, want: int, got: int) -> str:
    """Return the values in the output's unit; a hidden unit's as a number between -1 and 1."""
    if label.startswith("gru["):
        return f": state {want / 2**30:.9f} against {got / 2**30:.9f}"
    if not label.startswith("drift["):
        return ""
    output = model.outputs[int(label[6:-1])]
    lsb = output.lsb_per_unit
    return f": {output.name} {want / lsb:.6g} {output.unit} against {got / lsb:.6g} {output.unit}"
