"""What a layer normalisation does with intervals.

Written from docs/reference/integer-layers.md, section 4. Shares no code with the generator and
needs the standard library only.
"""

from math import isqrt

from zerodrift_proof.certificate.arguments import number
from zerodrift_proof.certificate.gru import shift_right
from zerodrift_proof.certificate.intervals import IntervalMachine
from zerodrift_proof.certificate.values import FaultError, Pointer, Struct, Value

MOST = 128
EPSILON = 1 << 60
SPARE = 8
"""A number's square is one of the squares, so that it is at most sqrt(M) of their mean's root; and
what roundings add: 2^-27 of that, at most 6, and a half."""


def normalise(
    machine: IntervalMachine, layer: Struct, x: Pointer, y: Pointer, count: Value
) -> None:
    """Bound every sum by the sizes of its terms; the results by what the parts are limited to.

    Args:
        machine: runs the model.
        layer: its constants.
        x: int16 copies of what it reads.
        y: the results.
        count: how many there are.
    """
    n = number(count, 1, MOST, "the number of normalised values")
    name = layer.name.removesuffix("_p")
    if x.block is y.block:
        raise FaultError(f"{name}: it reads what it writes")
    align, gain, shift, bias = (
        machine.table_of(layer, field) for field in ("align", "gain", "shift", "bias")
    )
    if any(len(row) != n for row in (align, gain, shift, bias)):
        raise FaultError(f"{name}: its tables do not have {n} numbers")
    epsilon, reciprocal, root, mean_shift = (
        layer.fields[field].value(0).low
        for field in ("epsilon", "reciprocal", "root", "mean_shift")
    )
    log = n.bit_length() - 1
    wanted = (2 * (1 << 27 + log) + n) // (2 * n), isqrt(n << 52), 27 + log
    if (reciprocal, root, mean_shift) != wanted or not 1 <= epsilon <= EPSILON:
        raise FaultError(f"{name}: its constants are not those of {n} numbers")
    for i in range(n):
        for field, row in (("align", align), ("shift", shift)):
            shift_right(machine, Value(0, 0), Value(row[i], row[i]), 62)
            machine.note_shift(f"{name}[{i}].{field}", row[i])
    machine.note_shift(f"{name}.mean_shift", mean_shift)
    raised = []
    for by, v in zip(align, x.values(n), strict=True):
        half = 1 << by >> 1
        raised.append(max(abs(((end << 12) + half) >> by) for end in (v.low, v.high)))
    total = sum(raised)
    product = total * reciprocal + (1 << mean_shift >> 1)
    away = max(raised) + (product >> mean_shift) + 1
    # the mean as an integer is at most `astray` from the true one
    astray = total * abs(reciprocal * n - (1 << mean_shift)) // (n << mean_shift) + 2
    squares = epsilon + sum(v * v for v in raised) + n * astray * astray
    scale = (((1 << 30) + 4) * root) >> 29
    machine.note(f"{name}.sum", -total, total, 64)
    machine.note(f"{name}.mean", -product, product, 64)
    machine.note(f"{name}.difference", -away, away, 32)
    machine.note(f"{name}.squares", 0, squares, 63)
    machine.note(f"{name}.scale", 0, scale, 32)
    part = away * scale + (1 << 30)
    machine.note(f"{name}.part", -part, part, 64)
    results = []
    for i in range(n):
        scaled = (root + SPARE) * abs(gain[i]) + (1 << shift[i] >> 1)
        largest = (scaled >> shift[i]) + 1 + abs(bias[i])
        reach = largest + (1 << 14)
        machine.note(f"{name}[{i}].product", -scaled, scaled, 64)
        machine.note(f"{name}[{i}]", -reach, reach, 32)
        ends = ((-largest + (1 << 14)) >> 15, (largest + (1 << 14)) >> 15)
        machine.note(f"{name}[{i}].copy", *ends, 16)
        results.append(Value(-largest, largest))
    y.fill(results)
    machine.shift = None
