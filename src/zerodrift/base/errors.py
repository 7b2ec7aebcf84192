"""The errors a user can cause, and the exit code each one ends with."""

import difflib
from collections.abc import Iterable


class ZerodriftError(Exception):
    """Base of every error that the user sees as one message, without a traceback.

    Example:
        >>> issubclass(zd.InputError, zd.ZerodriftError), zd.CheckError.exit_code
        (True, 1)
    """

    exit_code = 2


class InputError(ZerodriftError):
    """The input or the usage is wrong: where, what was found, what was expected, what to do."""

    exit_code = 2


class NoRuleError(ZerodriftError):
    """No error bound can be proven for a model with this; the text says why."""


class CheckError(ZerodriftError):
    """A check ran and failed: bits differ, a certificate was refused.

    Args:
        text: what failed, and what to do.
        result: the record that `--json` prints of it all the same, where there is one.
    """

    exit_code = 1

    def __init__(self, text: str, result: object = None) -> None:
        super().__init__(text)
        self.result = result


def nearest(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the known names closest to `name`, or an empty string."""
    matches = difflib.get_close_matches(name, list(known), n=3, cutoff=0.5)
    if not matches:
        return ""
    return "; did you mean " + " or ".join(f"'{match}'" for match in matches) + "?"
