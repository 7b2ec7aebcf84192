"""Prints each dependency, the laboratory's too, at the lowest version allowed, one a line, for pip.

python .ci/lowest.py EXTRA...
"""

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent


def list_lowest(project: dict[str, object], extras: list[str]) -> list[str]:
    """Return `NAME==VERSION` of each dependency, those of extras included.

    Args:
        project: the table [project] of pyproject.toml.
        extras: names of optional dependencies.

    Raises:
        ValueError: one has no lower bound, so that its oldest version is not known.
    """
    wanted = list(project["dependencies"])
    for extra in extras:
        wanted += project["optional-dependencies"][extra]
    lowest = set()
    for one in wanted:
        found = re.fullmatch(r"([\w.-]+(?:\[[\w,]+\])?)>=([\d.]+)", one)
        if found is None:
            raise ValueError(f"pyproject.toml: '{one}'; expected NAME>=VERSION")
        lowest.add(f"{found[1]}=={found[2]}")
    return sorted(lowest)


if __name__ == "__main__":
    own, lab = (
        tomllib.loads((ROOT / name).read_text(encoding="utf-8"))["project"]
        for name in ("pyproject.toml", "lab/pyproject.toml")
    )
    own["dependencies"] += [name for name in lab["dependencies"] if name != own["name"]]
    print("\n".join(list_lowest(own, sys.argv[1:])))
