"""Finds the packages: a top folder with an `__init__.py` is a stage, `zerodrift.FOLDER`."""

from pathlib import Path

from setuptools import find_packages, setup

ROOT = Path(__file__).parent
UNSHIPPED = ("tests", "benchmarks", "manual")
"""Packages of the repository that are no part of zerodrift."""


def find_stages() -> list[str]:
    """Return the stages' folders, sorted."""
    folders = (path.parent.name for path in ROOT.glob("*/__init__.py"))
    return sorted(name for name in folders if name not in UNSHIPPED)


if __name__ == "__main__":
    stages = find_stages()
    below = find_packages(str(ROOT), include=[f"{stage}*" for stage in stages])
    below = [name for name in below if name.split(".")[0] in stages]
    setup(
        packages=[*find_packages("src"), *(f"zerodrift.{name}" for name in below)],
        package_dir={"": "src", **{f"zerodrift.{stage}": stage for stage in stages}},
        package_data={
            "zerodrift": ["py.typed"],
            "": ["*.j2", "*.txt", "*.h", "*.c", "templates/*", "assets/*", "protocols/*.txt"],
            "zerodrift.c_runtime": ["include/zerodrift/*.h", "src/*.c", "bare_metal/*.c"],
        },
    )
