"""A C++ compiler for the tests of packages: g++, or the ziglang wheel's, which is always there."""

import shutil
import sys


def find_cxx() -> list[str]:
    """Return the command."""
    path = shutil.which("g++")
    return [path] if path else [sys.executable, "-m", "ziglang", "c++"]
