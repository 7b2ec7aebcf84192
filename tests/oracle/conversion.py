"""Section 2.2 of docs/reference/integer-arithmetic.md: raw codes become the channels' codes."""

from collections.abc import Sequence
from typing import Any

from tests.oracle.primitives import fit


def convert(channels: Sequence[dict[str, Any]], raw: Sequence[int]) -> list[int]:
    """Return the code of every channel."""
    return [
        _convert(channel["conversion"], code) if "conversion" in channel else code
        for channel, code in zip(channels, raw, strict=True)
    ]


def _convert(by: dict[str, Any], raw: int) -> int:
    bits = {"uint16": 17, "int16": 16, "int32": 32}[by["raw"]]
    assert raw >= 0 or by["raw"] != "uint16"
    fit(raw, bits)
    first, nodes, width = by["first"], by["nodes"], 2 ** by["block_bits"]
    if by["none"] is not None and (raw < by["begin"] or raw > by["end"] or raw == by["lacks"]):
        return int(by["none"])
    if not nodes:
        return raw
    place = min(max(raw, by["low"]), by["high"]) - by["low"]
    block, within = divmod(place, width)
    line, f = divmod(within * (first[block + 1] - first[block]), width)
    line += first[block]
    total = 2 ** by["shift"] // 2 + nodes[line] * width + (nodes[line + 1] - nodes[line]) * f
    fit(total, 64)
    return int(min(max(total // 2 ** by["shift"], by["lowest"]), by["highest"]))
