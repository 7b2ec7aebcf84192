"""Section 2.2 of docs/reference/integer-arithmetic.md: raw codes become the channels' codes."""

from collections.abc import Sequence
from typing import Any

from tests.oracle.primitives import fit


def convert(channels: Sequence[dict[str, Any]], raw: Sequence[int]) -> list[int]:
    """Return the code of every channel."""
    codes = [
        _convert(channel["conversion"], code)
        if "conversion" in channel and "junction" not in channel["conversion"]
        else code
        for channel, code in zip(channels, raw, strict=True)
    ]
    for index, channel in enumerate(channels):
        if "junction" in channel.get("conversion", {}):
            by = channel["conversion"]
            codes[index] = _convert_couple(by, raw[index], codes[by["junction"]["channel"]])
    return codes


def _convert_couple(by: dict[str, Any], raw: int, cold: int) -> int:
    junction = by["junction"]
    total = raw * 2 ** by["fraction_bits"] + _look_up(junction, cold)
    total = min(max(total, -(2**31)), 2**31 - 1)
    lacks = [raw == by["lacks"], cold == junction["lacks"]]
    if by["none"] is not None and (total < by["begin"] or total > by["end"] or any(lacks)):
        return int(by["none"])
    return _look_up(by, total)


def _convert(by: dict[str, Any], raw: int) -> int:
    bits = {"uint16": 17, "int16": 16, "int32": 32}[by["raw"]]
    assert raw >= 0 or by["raw"] != "uint16"
    fit(raw, bits)
    if by["none"] is not None and (raw < by["begin"] or raw > by["end"] or raw == by["lacks"]):
        return int(by["none"])
    return _look_up(by, raw) if by["nodes"] else raw


def _look_up(by: dict[str, Any], raw: int) -> int:
    first, nodes, width = by["first"], by["nodes"], 2 ** by["block_bits"]
    place = min(max(raw, by["low"]), by["high"]) - by["low"]
    block, within = divmod(place, width)
    line, f = divmod(within * (first[block + 1] - first[block]), width)
    line += first[block]
    total = 2 ** by["shift"] // 2 + nodes[line] * width + (nodes[line + 1] - nodes[line]) * f
    fit(total, 64)
    return int(min(max(total // 2 ** by["shift"], by["lowest"]), by["highest"]))
