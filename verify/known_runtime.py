"""The texts of the runtime that were compared with the reference, by their hash.

The checker has no rules for intrinsics and for what a kernel does inside: kernels are taken at
their specification. That holds for the texts known here and no others, whatever runtime is beside a
model. Shares no code with the generator and needs the standard library only.
"""

import hashlib
from collections.abc import Mapping

CURRENT = (3, "6fadffb821d8d5e90601bc25f5c8956bb739c0e20987e30181bc32bb49a44fcd")
"""Runtime format, and hash of all files of this version; written by `make golden`."""
RELEASED: tuple[tuple[int, str], ...] = ()
"""The same of every version that was ever released."""


def hash_runtime(texts: Mapping[str, str]) -> str:
    """Return one hash of all files of a runtime, by name.

    Args:
        texts: file name -> content; files that are not the runtime's are left out.
    """
    lines = [
        f"{name} {hashlib.sha256(text.encode()).hexdigest()}\n"
        for name, text in sorted(texts.items())
        if name.startswith("zd_")
    ]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def is_known(texts: Mapping[str, str]) -> bool:
    """Return whether these are the files of a runtime that was compared with the reference."""
    return hash_runtime(texts) in {digest for _, digest in (CURRENT, *RELEASED)}
