"""The identity of the files of one generated model, and of the runtime beside it."""

import hashlib
import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

_RUNTIME = files("zerodrift.c_runtime") / "include" / "zerodrift" / "zd_runtime.h"
PLACEHOLDER = "ZD_CODE_ID_UNKNOWN"
"""Stands in header and source until their identity is known."""
NO_IDENTITY = "@IDENTITY@"
"""Stands in the runtime's files until theirs is known."""
_CODE_ID = re.compile(r"(?<=_CODE_ID )(!= )?(UINT32_C\(\d+\)|\d+)")
_LISTED = re.compile(r"(\n \* [^\n]*hash of its text:\n)((?: \* zd_\w+\.[ch] \w{8}\n)*)( \*/)")
_LINE = re.compile(r" \* (\S+) (\w{8})\n")
_RUNTIME_ID = re.compile(r"#define ZD_RUNTIME_ID 0x(\w{8})")


@cache
def find_runtime_identity() -> str:
    """Return ZD_RUNTIME_ID of the runtime that is written beside a model, as the C has it."""
    return read_runtime_identity({_RUNTIME.name: _RUNTIME.read_text(encoding="utf-8")})


def read_runtime_identity(texts: Mapping[str, str]) -> str:
    """Return ZD_RUNTIME_ID of some runtime's files, name -> text; "" if they have none."""
    found = _RUNTIME_ID.search(texts.get(_RUNTIME.name, ""))
    return f"0x{found[1]}" if found else ""


def identify(header: str, source: str) -> tuple[str, str]:
    """Return header and source with their identity, a number of 32 bits, for its placeholder."""
    digest = hashlib.sha256(f"{header}\0{source}".encode()).digest()
    identity = str(int.from_bytes(digest[:4], "big"))  # cppcheck knows no UINT32_C in #if
    return header.replace(PLACEHOLDER, identity), source.replace(PLACEHOLDER, identity)


def identify_again(header: str, source: str) -> tuple[str, str]:
    """Return header and source of any version with the identity that their text has now."""

    def forget(text: str) -> str:
        return _CODE_ID.sub(rf"\g<1>{PLACEHOLDER}", text)

    return identify(forget(header), forget(source))


def read_code_identities(*texts: str) -> list[int]:
    """Return the numbers that header or source call their identity; older C has none."""
    found = [match[2] for text in texts for match in _CODE_ID.finditer(text)]
    return [int(re.sub(r"\D", "", number.removeprefix("UINT32_C"))) for number in found]


def identify_runtime(texts: Mapping[str, str]) -> dict[str, str]:
    """Return a runtime's files, name -> text, with the identity that they have together.

    `zd_runtime.h` lists the files and their hashes, by which any part of them is held against the
    identity of the whole. The runtimes of earlier versions have no list, and lie there as a whole.

    Args:
        texts: all of its files, or those that a model includes.
    """
    before = read_runtime_identity(texts).removeprefix("0x")
    bare = {n: text.replace(before, NO_IDENTITY) if before else text for n, text in texts.items()}
    listed = _LISTED.search(bare.get(_RUNTIME.name, ""))
    if listed is None:
        identity = _hash_together(bare)
    else:
        bare[_RUNTIME.name] = _LISTED.sub(r"\1\3", bare[_RUNTIME.name])
        hashes = dict(_LINE.findall(listed[2]))
        hashes |= {name: hashlib.sha256(t.encode()).hexdigest()[:8] for name, t in bare.items()}
        own = hashes.pop(_RUNTIME.name)
        lines = "".join(f" * {name} {digest}\n" for name, digest in sorted(hashes.items()))
        identity = hashlib.sha256(f"{own}\n{lines}".encode()).hexdigest()[:8]
        bare[_RUNTIME.name] = _LISTED.sub(rf"\1{lines}\3", bare[_RUNTIME.name])
    return {name: text.replace(NO_IDENTITY, identity) for name, text in bare.items()}


def _hash_together(texts: Mapping[str, str]) -> str:
    """Return the identity of a runtime without a list."""
    digest = hashlib.sha256()
    for name in sorted(texts):
        digest.update(f"{name}\0{texts[name]}\0".encode())
    return digest.hexdigest()[:8]
