"""What tells the files of one generated model, and the runtime beside it, from all others."""

import hashlib
import re
from functools import cache
from importlib.resources import files

_RUNTIME = files("zerodrift.c_runtime") / "include" / "zerodrift" / "zd_runtime.h"
PLACEHOLDER = "ZD_CODE_ID_UNKNOWN"
"""Stands in header and source until their identity is known."""


@cache
def read_runtime_identity() -> str:
    """Return ZD_RUNTIME_ID of the runtime that is written beside a model, as the C has it."""
    found = re.search(r"#define ZD_RUNTIME_ID (0x\w{8})", _RUNTIME.read_text(encoding="utf-8"))
    assert found is not None, _RUNTIME
    return found[1]


def identify(header: str, source: str) -> tuple[str, str]:
    """Return header and source with their identity, a number of 32 bits, for its placeholder."""
    digest = hashlib.sha256(f"{header}\0{source}".encode()).digest()
    identity = str(int.from_bytes(digest[:4], "big"))  # cppcheck knows no UINT32_C in #if
    return header.replace(PLACEHOLDER, identity), source.replace(PLACEHOLDER, identity)
