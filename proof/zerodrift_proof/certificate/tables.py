"""The runtime's tables as the checker reads them.

Shares no code with the generator and needs the standard library only.
"""

import itertools
from collections.abc import Mapping

from zerodrift_proof.certificate.values import NotUnderstoodError


def read_lines(tables: Mapping[str, list[int]]) -> list[tuple[int, int]]:
    """Return tanh in Q0.30 at the first and last input of each of the 512 lines of its table.

    Either the 513 nodes are stored, or offset and slope of each line over the position. A runtime
    without a network has no such table, and no lines.
    """
    if not any(name.startswith("zd_tanh_") for name in tables):
        return []
    if nodes := tables.get("zd_tanh_nodes_q19"):
        pairs = itertools.pairwise(nodes)
        lines = [(a << 11, (a << 11) + (b - a) * 2047) for a, b in pairs]
    else:
        both = zip(tables["zd_tanh_offset_q30"], tables["zd_tanh_slope_q19"], strict=False)
        lines = []
        for line, (offset, slope) in enumerate(both, -256):
            ends = [slope * ((line << 11) + f) for f in (0, 2047)]
            if max(map(abs, ends)) >= 1 << 31:
                raise NotUnderstoodError(f"line {line} of tanh: the slope's product overflows")
            lines.append((offset + ends[0], offset + ends[1]))
        _require_half(tables)
        raised = [offset + 2**30 for offset in tables["zd_tanh_offset_q30"]]
        if tables.get("zd_sigmoid_offset_q31", raised) != raised:
            raise NotUnderstoodError("zd_sigmoid_offset_q31 is not half a unit above tanh's")
    if len(lines) != 512:
        raise NotUnderstoodError(f"tanh has {len(lines)} lines; 512 are read")
    return lines


def _require_half(tables: Mapping[str, list[int]]) -> None:
    """Raise where the lines that are read at -Os are not those of the whole table, on either side.

    They lie from 0 on; the last one is level and holds beyond; at -t the offset's sign changes.
    """

    def pair(stem: str) -> list[tuple[int, int]]:
        names = (f"zd_tanh_{stem}offset_q30", f"zd_tanh_{stem}slope_q19")
        return list(zip(*(tables[name] for name in names), strict=False))

    if "zd_tanh_half_offset_q30" in tables:
        half, whole = pair("half_"), pair("")
        sizes = {len(tables[f"zd_tanh_half_{name}"]) for name in ("offset_q30", "slope_q19")}
        half += [half[-1]] * (256 - len(half))
        mirrored = [(-offset, slope) for offset, slope in reversed(half)]
        if len(sizes) > 1 or half[-1][1] != 0 or mirrored + half != whole[:512]:
            raise NotUnderstoodError("zd_tanh_half_* is not the table of the other cores")
