"""zerodrift: temperature logs in, bit-exact fixed-point drift-compensation firmware out.

Example:
    >>> import zerodrift as zd
    >>> zd.__version__
    '0.1.0'
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zerodrift import effects
    from zerodrift.api.frames import Output
    from zerodrift.api.project import Project
    from zerodrift.base.errors import CheckError, InputError, ZerodriftError

__version__ = "0.1.0"
__all__ = ["CheckError", "InputError", "Output", "Project", "ZerodriftError", "effects"]

_PLACES = {
    "Project": "api.project",
    "Output": "api.frames",
    "InputError": "base.errors",
    "CheckError": "base.errors",
    "ZerodriftError": "base.errors",
}


def __getattr__(name: str) -> object:
    """Load a name's module on first use; importing zerodrift loads only the standard library."""
    if name == "effects":
        return import_module("zerodrift.effects")
    if name in _PLACES:
        return getattr(import_module(f"zerodrift.{_PLACES[name]}"), name)
    raise AttributeError(f"module 'zerodrift' has no attribute '{name}'")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted([*__all__, "__version__"])
