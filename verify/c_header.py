"""What a header tells its caller to index `drift[]` by, held against the array that is written."""

import re

SCALE = "_LSB_PER_UNIT"
"""Ends the name of an output's scale; without it, that of its index."""


def find_wrong_indices(header: str, prefix: str) -> list[str]:
    """Return what is wrong with the names of the outputs: each has to be a place of its own.

    A caller reads `drift[PREFIX_NAME]` from an array of `PREFIX_OUTPUTS`; nothing in the C itself
    uses the names. An output is what has an `_LSB_PER_UNIT`.

    Args:
        header: text of the model's header.
        prefix: of its names, as in the file's name.
    """
    upper = prefix.upper()
    defined = re.findall(rf"(?m)^[ \t]*#[ \t]*define[ \t]+{upper}_(\w+)[ \t]+(\S+)", header)
    values = dict(reversed(defined))
    count = values.get("OUTPUTS", "")
    if not re.fullmatch(r"[1-9]\d*", count):
        return [f"{upper}_OUTPUTS: is '{count}', no number of outputs"]
    scaled = (name.removesuffix(SCALE) for name in values if name.endswith(SCALE))
    names = [name for name in scaled if name in values]
    found = []
    for name, value in defined:
        if name in names and not (re.fullmatch(r"0|[1-9]\d*", value) and int(value) < int(count)):
            found.append(f"{upper}_{name}: is {value}, outside of drift[{count}]")
    indices = sorted(
        int(value) for name, value in values.items() if name in names and value.isdigit()
    )
    if indices != list(range(int(count))):
        found.append(
            f"the outputs' indices are {indices}; expected 0 .. {int(count) - 1}, each once"
        )
    return found
