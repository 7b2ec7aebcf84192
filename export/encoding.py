"""From quantities to the codes that the hardware would have given for them, and back."""

from dataclasses import replace

import numpy as np

from zerodrift.base.arrays import Array, IntArray, Mask
from zerodrift.dataset.chip_codes import RawRange, find_code
from zerodrift.dataset.conversions import convert
from zerodrift.export.integer_model import Channel, IntegerModel, order_conversions
from zerodrift.operations.arithmetic import CodeArray


def find_held(channel: Channel) -> tuple[float, float]:
    """Return the lowest and highest value that a code represents, in the channel's unit."""
    if channel.conversion is None or channel.conversion.is_plain:
        ends = (channel.raw_least, channel.raw_most)
        low, high = sorted(code * channel.lsb + channel.offset for code in ends)
        return low, high
    low, high = sorted(_find_range(channel).values)
    return low, high


def encode_channel(
    channel: Channel, values: Array, junction: IntArray | None = None
) -> tuple[Array, Mask]:
    """Return the codes [n] of values [n] of a channel, raw codes where the chip takes them.

    Args:
        channel: of a model.
        values: [n] in its unit.
        junction: [n] codes of a thermocouple's cold junction.

    Returns:
        whole numbers, the nearest code where none represents a value (NaN stays NaN); and where
        that is so, which includes the codes that mean no reading.
    """
    low, high = find_held(channel)
    if channel.conversion is None or channel.conversion.is_plain:
        codes = np.round((values - channel.offset) / channel.lsb)
        outside = ~((codes >= channel.raw_least) & (codes <= channel.raw_most))
        outside |= codes == channel.no_reading
        return np.clip(codes, channel.raw_least, channel.raw_most), outside
    by = channel.conversion
    known = np.where(np.isnan(values), low, values)
    codes = find_code(by.by_sum, _find_range(channel), known)
    outside = ~((values >= low) & (values <= high))
    if by.junction is not None and by.fraction_bits is not None:
        assert junction is not None
        raw = np.round((codes - by.junction.convert(junction)) / 2.0**by.fraction_bits)
        codes = np.clip(raw, channel.raw_least, channel.raw_most)
        outside |= codes != raw
    if by.none is not None and by.lacks is not None:
        outside |= codes == by.lacks
    return np.where(np.isnan(values), np.nan, codes), outside


def encode_values(model: IntegerModel, values: Array) -> tuple[list[int], CodeArray]:
    """Return per channel how many values lie beyond its codes, and the steps' inputs [n, ...].

    Args:
        model: has the channels.
        values: [n, C]; NaN only for a channel that has a code for "no reading".
    """
    counts, columns = [0] * len(model.channels), dict[int, Array]()
    converted = order_conversions(model.channels)
    for index in [i for i in range(len(model.channels)) if i not in converted] + converted:
        by, cold = model.channels[index].conversion, None
        if by is not None and by.junction is not None:
            of = model.channels[by.junction.channel]
            cold = columns[by.junction.channel].astype(np.int64)
            cold = cold if of.conversion is None else of.conversion.convert(cold)
        codes, beyond = _encode_channel(model.channels[index], values[:, index], cold)
        counts[index], columns[index] = beyond, codes
    given = [columns[index] for index in range(len(columns))]
    if model.variable_step:
        given.append(np.full(len(values), float(model.period_us)))
    return counts, np.stack(given, axis=1).astype(model.code_type)


def _encode_channel(
    channel: Channel, values: Array, junction: IntArray | None
) -> tuple[Array, int]:
    """Return codes [n], raw codes where the chip takes them, and how many values lie beyond."""
    codes, beyond = encode_channel(channel, values, junction)
    lacks = np.isnan(values)
    if channel.conversion is None:  # one of them may be the code for no reading, which is flagged
        beyond = codes != np.round((values - channel.offset) / channel.lsb)
    if lacks.any():
        if not channel.raw_lacks:
            raise ValueError(f"{channel.name}: no code says that a reading is lacking")
        codes = np.where(lacks, float(channel.raw_lacks[0]), codes)
    return codes, int(np.sum(beyond & ~lacks))


def round_channel(channel: Channel, values: Array) -> Array:
    """Return what is left of values [n] in the channel's codes, however large these would be.

    Of a conversion, what its table makes of the code that the hardware would give.
    """
    by = channel.conversion
    if by is None or by.is_plain:
        codes = np.round((values - channel.offset) / channel.lsb)
    else:
        given = find_code(by.by_sum, _find_range(channel), values)
        if by.fraction_bits is not None:  # what is left of a sum whose junction is at a raw code
            given = np.round(given / 2.0**by.fraction_bits) * 2.0**by.fraction_bits
        inside = (given >= by.low) & (given <= by.high)
        table = replace(by, junction=None, none=None)
        converted = table.convert(np.clip(given, by.low, by.high).astype(np.int64))
        return np.where(inside, converted * channel.lsb + channel.offset, values)
    return np.asarray(codes * channel.lsb + channel.offset)


def _find_range(channel: Channel) -> RawRange:
    """Return the raw codes that are readings, and the values at both ends."""
    by = channel.conversion
    assert by is not None
    ends = convert(np.array([by.begin, by.end], dtype=np.float64), by.by_sum)
    return RawRange(by.begin, by.end, (float(ends[0]), float(ends[1])), bool(ends[1] > ends[0]))
