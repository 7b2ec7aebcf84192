"""What a plain install takes of the disk: zerodrift and all that it requires, extras left out."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))[
    "project"
]
EXTRAS = ("train", "page", "fleet")
TARGET_GB = 0.97


def main(quick: bool) -> int:
    """Print the summed sizes of the files of the core, and of each extra beyond it.

    The target for the core, with compiler and emulator, is `TARGET_GB`. `quick` changes nothing.
    Returns 1 where the core is larger.
    """
    del quick
    core = collect(PROJECT["dependencies"])
    size_gb = sum(core.values()) / 1e9
    print(f"core: {len(core)} packages, {size_gb:.3f} GB (target {TARGET_GB} GB)")
    for name, size in sorted(core.items(), key=lambda item: -item[1])[:6]:
        print(f"  {name} {size / 1e6:.0f} MB")
    for extra in EXTRAS:
        try:
            more = collect(PROJECT["optional-dependencies"][extra])
        except PackageNotFoundError as error:
            print(f"[{extra}]: not measured, for {error.name} is not installed here")
            continue
        beyond = sum(size for name, size in more.items() if name not in core)
        print(f"[{extra}]: {beyond / 1e9:.3f} GB more")
    return int(size_gb > TARGET_GB)


def collect(requirements: list[str]) -> dict[str, int]:
    """Return package -> bytes of its files, of some requirements and all that these require."""
    sizes: dict[str, int] = {}
    waiting = [Requirement(text) for text in requirements]
    while waiting:
        wanted = waiting.pop()
        key = re.sub(r"[-_.]+", "-", wanted.name).lower()
        if key in sizes and not wanted.extras:
            continue
        found = distribution(wanted.name)
        files = found.files or []
        sizes[key] = sum(p.stat().st_size for f in files if (p := Path(f.locate())).is_file())
        for requirement in map(Requirement, found.requires or []):
            marker = requirement.marker
            if marker is None or any(marker.evaluate({"extra": e}) for e in (*wanted.extras, "")):
                waiting.append(requirement)
    return sizes
