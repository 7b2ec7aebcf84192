"""The sequence that `selftest()` replays on the chip, and the CRC that it must find."""

import zlib

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.node import ChannelNode

SELFTEST_STEPS = 64
SELFTEST_SEED = 0x5EED1E57


def draw_codes(low: list[int], high: list[int], *, timed: bool = False) -> IntArray:
    """Return the self-test's input codes [1, steps + 1, C]; the first row is where it settles.

    A 32-bit linear congruential generator (Numerical Recipes: 1664525, 1013904223) gives one value
    per channel and step; its upper 16 bits, scaled, spread over low .. high. Where steps are told
    their time, one more gives microseconds: its upper 16 bits times a power of two.
    """
    seed = SELFTEST_SEED
    rows = []
    for _ in range(SELFTEST_STEPS + 1):
        row = []
        for a, b in zip(low, high, strict=True):
            seed = (seed * 1664525 + 1013904223) & 0xFFFFFFFF
            row.append(a + (((seed >> 16) * (b - a + 1)) >> 16))
        if timed:
            seed = (seed * 1664525 + 1013904223) & 0xFFFFFFFF
            row.append((seed >> 16) << ((seed >> 11) & 31))
        rows.append(row)
    return np.array([rows], dtype=np.int64)


def limits_of(model: IntegerModel) -> tuple[list[int], list[int]]:
    """Return lowest and highest code of each channel; unused channels keep the full range.

    They are those that the chip is given. A raw output has the limits of its load.
    """
    low = [channel.raw_least for channel in model.channels]
    high = [channel.raw_most for channel in model.channels]
    for node in model.nodes:
        if isinstance(node, ChannelNode):
            by = model.channels[node.channel].conversion
            ends = [node.low, node.high]
            if by is not None:
                ends = sorted(int(code) for code in by.find(np.array(ends)))
            low[node.channel], high[node.channel] = ends
    return low, high


def compute_selftest(model: IntegerModel, limits: IntegerModel | None = None) -> int:
    """Return the CRC-32 over all drifts and flags of the self-test, each as 4 bytes, low first.

    Args:
        model: whose answers they are.
        limits: the model between whose limits the codes are drawn; None: its own.
    """
    ends = limits_of(model if limits is None else limits)
    codes = draw_codes(*ends, timed=model.variable_step)
    reference = Reference(model)
    state = reference.start(codes[:, 0].astype(np.int64), settled=True)
    trace = reference.run(codes[:, 1:], state=state)
    crc = 0
    for drift, flags in zip(trace.drift[0], trace.flags[0], strict=True):
        crc = zlib.crc32(drift.astype("<i4").tobytes(), crc)
        crc = zlib.crc32(int(flags).to_bytes(4, "little"), crc)
    return crc
