"""The arrays of a model file, as nested lists."""

from typing import Any

Node = dict[str, Any]


def read_vector(field: Node) -> list[int]:
    """Return an array of one dimension."""
    (length,) = field["shape"]
    assert len(field["data"]) == length
    return list(field["data"])


def read_rows(field: Node) -> list[list[int]]:
    """Return an array of two dimensions, row by row."""
    rows, columns = field["shape"]
    data = field["data"]
    assert len(data) == rows * columns
    return [data[row * columns : (row + 1) * columns] for row in range(rows)]


def read_gates(field: Node) -> list[list[list[int]]]:
    """Return an array of three dimensions: one list of rows per gate."""
    gates, rows, columns = field["shape"]
    flat = read_rows({"shape": [gates * rows, columns], "data": field["data"]})
    return [flat[gate * rows : (gate + 1) * rows] for gate in range(gates)]


def check_width(values: Any, bits: int) -> None:
    """Assert that all numbers in nested lists fit a signed integer of that many bits."""
    if isinstance(values, list):
        for value in values:
            check_width(value, bits)
    else:
        assert -(2 ** (bits - 1)) <= values < 2 ** (bits - 1), values
