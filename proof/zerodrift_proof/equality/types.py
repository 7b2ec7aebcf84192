"""C's integer types as the proof has them: fixed widths, and an int of 32 bits."""

BITS = {f"{sign}int{n}_t": n for n in (8, 16, 32, 64) for sign in ("", "u")}


def is_signed(kind: str) -> bool:
    """Return whether an integer type has a sign."""
    return kind[0] == "i"


def _find_range(kind: str) -> tuple[int, int]:
    half = 1 << (BITS[kind] - 1)
    return (-half, half - 1) if is_signed(kind) else (0, 2 * half - 1)


TYPES = {kind: _find_range(kind) for kind in BITS}
"""Type -> its least and its largest number."""
LIMITS = {
    f"{kind.removesuffix('_t').upper()}_{end}": value
    for kind, ends in TYPES.items()
    for end, value in zip(("MIN", "MAX"), ends, strict=True)
    if end == "MAX" or is_signed(kind)
}
"""Names of stdint.h that stand for these."""
