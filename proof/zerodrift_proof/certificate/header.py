"""What a header tells its caller to index `drift[]` by, held against the array that is written."""

import re
from collections.abc import Mapping, Sequence

SCALE = "_LSB_PER_UNIT"
"""Ends the name of an output's scale; without it, that of its index."""


def find_wrong_indices(macros: Mapping[str, Sequence[str]], prefix: str) -> list[str]:
    """Return what is wrong with the names of the outputs: each has to be a place of its own.

    A caller reads `drift[PREFIX_NAME]` from an array of `PREFIX_OUTPUTS`; nothing in the C itself
    uses the names. An output is what has an `_LSB_PER_UNIT`.

    Args:
        macros: of the model's header, name -> words that it stands for.
        prefix: of its names, as in the file's name.
    """
    own = f"{prefix.upper()}_"
    count = " ".join(macros.get(f"{own}OUTPUTS", ()))
    if not re.fullmatch(r"[1-9]\d*", count):
        return [f"{own}OUTPUTS: is '{count}', no number of outputs"]
    names = [name.removesuffix(SCALE) for name in macros if name.endswith(SCALE)]
    found, indices = [], []
    for name in names:
        value = " ".join(macros.get(name, ()))
        if not re.fullmatch(r"0|[1-9]\d*", value) or int(value) >= int(count):
            found.append(f"{name}: is '{value}', outside of drift[{count}]")
        else:
            indices.append(int(value))
    if sorted(indices) != list(range(int(count))):
        found.append(
            f"the outputs' indices are {sorted(indices)}; expected 0 .. {int(count) - 1}, each once"
        )
    return found
