"""The order in which each kernel reads a recurrent layer's numbers, laid out from the model.

Written from docs/reference/kernels.md and the comments above the kernels' structs in the runtime.
Two neighbours of 16 bits are a pair, one signed word, the first one low; a word of four weights of
8 bits holds the first, third, second and fourth, the first one low. What is missing to a whole pair
or vector is zero.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import chain

from zerodrift_proof.equality.kernels import Numbered

Tables = tuple[list[int], ...]
"""As the kernel's struct has them, in the order of its fields."""
EIGHT, FOUR = 8, 4
"""Numbers of 16 bits, and units, that MVE takes at once; the columns kernel takes eight units."""


def _sign(word: int) -> int:
    return word - (1 << 32) if word >> 31 else word


def _pair(row: Sequence[int]) -> list[int]:
    filled = [*row, *[0] * (len(row) % 2)]
    return [
        _sign(filled[k] & 0xFFFF | (filled[k + 1] & 0xFFFF) << 16)
        for k in range(0, len(filled), 2)
    ]  # fmt: skip


def _four(row: Sequence[int]) -> list[int]:
    filled = [*row, *[0] * (-len(row) % 4)]
    words = []
    for k in range(0, len(filled), 4):
        first, second, third, fourth = (n & 0xFF for n in filled[k : k + 4])
        words.append(_sign(first | third << 8 | second << 16 | fourth << 24))
    return words


def _rows_of(layer: Numbered, unit: int, of_state: bool) -> list[tuple[int, ...]]:
    """Return a unit's rows, gate by gate."""
    rows = layer.w_h if of_state else layer.w_x
    return list(rows[unit * layer.gates : (unit + 1) * layer.gates])


def _biases(layer: Numbered, unit: int) -> list[int]:
    return list(layer.bias[4 * unit : 4 * unit + 4])


def _multipliers(layer: Numbered, unit: int) -> list[int]:
    return list(layer.multiplier[layer.gates * unit : layer.gates * (unit + 1)])


def _blocks(rows: Sequence[Sequence[int]]) -> Iterator[int]:
    """Yield blocks of two pairs, gate by gate, the last one of one pair where they are odd."""
    words = [_pair(row) for row in rows]
    for first in range(0, len(words[0]), 2):
        for gate in words:
            yield from gate[first : first + 2]


def pack_pairs(layer: Numbered) -> Tables:
    """Return the stream of pairs: biases, blocks of features, blocks of the state, unit by unit."""
    stream: list[int] = []
    for unit in range(layer.hidden):
        stream += _biases(layer, unit)
        for of_state in (False, True):
            stream += _blocks(_rows_of(layer, unit, of_state))
    return (stream,)


def pack_before(layer: Numbered) -> Tables:
    """Return the stream of a reset before the product: r and u of all units, then n of all."""
    stream: list[int] = []
    for gates in (slice(0, 2), slice(2, 3)):
        for unit in range(layer.hidden):
            stream += _biases(layer, unit)[gates]
            for of_state in (False, True):
                stream += _blocks(_rows_of(layer, unit, of_state)[gates])
    return (stream,)


def _interleave(rows: Sequence[Sequence[int]]) -> list[int]:
    """Return the words of four weights, for each four those of all gates."""
    return list(chain.from_iterable(zip(*(_four(row) for row in rows), strict=True)))


def pack_bytes(layer: Numbered) -> Tables:
    """Return a GRU's stream with recurrent weights of 8 bits.

    Unit by unit: three biases, blocks of features, the fours of the state, the bias inside the
    reset, the multipliers.
    """
    stream: list[int] = []
    for unit in range(layer.hidden):
        bias = _biases(layer, unit)
        stream += [*bias[:3], *_blocks(_rows_of(layer, unit, False))]
        stream += [*_interleave(_rows_of(layer, unit, True)), bias[3], *_multipliers(layer, unit)]
    return (stream,)


def pack_lstm_bytes(layer: Numbered) -> Tables:
    """Return an LSTM's: the fours of the output, biases, multipliers, blocks of features."""
    stream: list[int] = []
    for unit in range(layer.hidden):
        stream += [*_interleave(_rows_of(layer, unit, True)), *_biases(layer, unit)]
        stream += [*_multipliers(layer, unit), *_blocks(_rows_of(layer, unit, False))]
    return (stream,)


def pack_columns(layer: Numbered) -> Tables:
    """Return eight units side by side: the four biases, then each pair of features gate by gate,
    then the same of the state; units beyond the last are zeros."""
    stream: list[int] = []
    for first in range(0, layer.hidden, EIGHT):
        units = range(first, first + EIGHT)
        stream += [_biases(layer, u)[k] if u < layer.hidden else 0 for k in range(4) for u in units]
        for of_state in (False, True):
            wide = [
                [_pair(row) for row in _rows_of(layer, u, of_state)] if u < layer.hidden else None
                for u in units
            ]
            for pair in range(-(-(layer.hidden if of_state else layer.inputs) // 2)):
                for gate in range(layer.gates):
                    stream += [rows[gate][pair] if rows else 0 for rows in wide]
    return (stream,)


def pack_rows(layer: Numbered) -> Tables:
    """Return weights, recurrent ones of 8 bits, biases and multipliers in whole vectors."""
    return _pack_rows(layer, (slice(0, layer.gates),))


def pack_rows_before(layer: Numbered) -> Tables:
    """The same with the reset before the product: weights of r and u of all units, then of n."""
    return _pack_rows(layer, (slice(0, 2), slice(2, 3)))


def _pack_rows(layer: Numbered, passes: Sequence[slice]) -> Tables:
    units = range(-(-layer.hidden // FOUR) * FOUR)
    scaled = bool(layer.multiplier)

    def fill(row: Sequence[int]) -> list[int]:
        return [*row, *[0] * (-len(row) % EIGHT)]

    def lay(of_state: Sequence[bool]) -> list[int]:
        table: list[int] = []
        for gates in passes:
            for unit in units:
                parts = [_rows_of(layer, min(unit, layer.hidden - 1), one) for one in of_state]
                for several in zip(*(part[gates] for part in parts), strict=True):
                    row = [n for one in several for n in fill(one)]
                    table += row if unit < layer.hidden else [0] * len(row)
        return table

    def spread(numbers: Callable[[Numbered, int], list[int]]) -> list[int]:
        table: list[int] = []
        for first in range(0, layer.hidden, FOUR):
            several = [
                numbers(layer, u) if u < layer.hidden else [0] * len(numbers(layer, 0))
                for u in range(first, first + FOUR)
            ]
            table += chain.from_iterable(zip(*several, strict=True))
        return table

    weights = lay((False,) if scaled else (False, True))
    small = lay((True,)) if scaled else []
    return weights, small, spread(_biases), spread(_multipliers) if scaled else []


def pack_assembly(layer: Numbered) -> Tables:
    """Return the stream of a layer in assembly, which its kind and its weights tell."""
    if layer.multiplier:
        return pack_lstm_bytes(layer) if layer.kind == "lstm" else pack_bytes(layer)
    return pack_before(layer) if layer.kind == "gru before" else pack_pairs(layer)
