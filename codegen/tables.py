"""The constant tables of a model other than a GRU's, as `selftest()` finds them in the C."""

from dataclasses import dataclass

import numpy as np

from zerodrift.codegen.layouts import crc_of_words
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.layers import IntegerDense
from zerodrift.operations.network import IntegerFeatures, IntegerHead
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.power import IntegerPower


@dataclass(frozen=True)
class Table:
    """An array of the generated C."""

    name: str
    type: str
    """i16, i32, u8 or i64."""
    numbers: tuple[int, ...]
    rows: int = 0
    """0 for one dimension."""

    @property
    def words(self) -> list[int]:
        """The numbers as the 32-bit words of the CRC; of 64 bits the lower half is first."""
        if self.type != "i64":
            return list(self.numbers)
        return [word for n in self.numbers for word in (n & 0xFFFFFFFF, (n >> 32) & 0xFFFFFFFF)]


def list_tables(model: IntegerModel) -> list[Table]:
    """Return the tables of all nodes in the order of the model."""
    return [table for node in model.nodes for table in _list_node(node)]


def crc_of_tables(tables: list[Table]) -> int:
    """Return the CRC-32 over all tables in order."""
    return crc_of_words([word for table in tables for word in table.words])


def _list_node(node: IntegerNode) -> list[Table]:
    match node:
        case IntegerFeatures():
            return [
                _table(node, "matrix", "i32", node.matrix, rows=node.width),
                _table(node, "bias", "i64", node.bias),
                _table(node, "shift", "u8", np.array(node.shift)),
            ]
        case IntegerPower():
            return [
                _table(node, "octave", "i32", np.array(node.octave)),
                _table(node, "gains", "i32", np.array(node.gains)),
            ]
        case IntegerHead():
            return [_table(node, "weights", "i16", node.weights)]
        case IntegerDense():
            limits = [
                _table(node, name, "i16", np.array(getattr(node, name)))
                for name in ("low", "high")
                if node.activation == "clip"
            ]
            return [
                _table(node, "weights", "i16", node.weights),
                _table(node, "bias", "i32", node.bias),
                _table(node, "shift", "u8", np.array(node.shift)),
                *limits,
            ]
    return []


def _table(
    node: IntegerNode,
    name: str,
    kind: str,
    numbers: np.ndarray[tuple[int, ...], np.dtype[np.signedinteger]],
    rows: int = 0,
) -> Table:
    return Table(f"{node.name}_{name}", kind, tuple(map(int, numbers.ravel())), rows)
