"""The one place where text goes to the terminal: control characters are written out there.

Names, units and messages come from files of anybody, and a terminal obeys what is in them: ESC
sequences move the cursor, hide lines, change its title or fill its clipboard. `guard_streams` has
everything that is printed pass through here; what rich draws itself (colours, a status line) passes
through `open_terminal`, which knows its own sequences from text.
"""

import re
import sys
from collections.abc import Iterable
from functools import cache
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import Console

CONTROLS = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]|\r(?!\n)"
)
"""C0 but tab and line feed, DEL, C1, and what reverses the direction of writing (Unicode TR 9)."""


def escape_controls(text: str) -> str:
    r"""Return a text with control characters written out, as \x1b is.

    Tabs and ends of lines stay.
    """
    return CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


class GuardedStream:
    """A text stream on which control characters are written out.

    It has no `buffer`, by which they would get past.
    """

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw

    def write(self, text: str | bytes) -> int:
        """Write a text; return its length. Of bytes, as click hands over, it is UTF-8."""
        if isinstance(text, bytes):
            text = text.decode("utf-8", "backslashreplace")
        self.raw.write(escape_controls(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> object:
        """Return what the stream itself has."""
        if name == "buffer":
            raise AttributeError(name)
        return getattr(self.raw, name)


def guard_streams() -> None:
    """Have everything that is printed on stdout and stderr pass through here."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, GuardedStream):
            setattr(sys, name, GuardedStream(stream))


def open_terminal(*, stderr: bool = False, width: int | None = None) -> "Console":
    """Return rich's console for stdout or stderr; text on it is plain, square brackets too.

    Args:
        stderr: whether it is for stderr.
        width: in columns; None: as wide as the terminal.
    """
    stream = sys.stderr if stderr else sys.stdout
    raw = stream.raw if isinstance(stream, GuardedStream) else stream
    return _load_console()(file=raw, width=width, highlight=False, markup=False, emoji=False)


@cache
def _load_console() -> "type[Console]":
    """Return the class of the console; rich is loaded when something is printed by it."""
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class Terminal(Console):
        """A console that writes out control characters of texts; its own sequences stay."""

        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterable[Segment]:
            """Return the segments of what is printed."""
            for segment in super().render(renderable, options):
                if segment.control is None and CONTROLS.search(segment.text):
                    yield Segment(escape_controls(segment.text), segment.style)
                else:
                    yield segment

    return Terminal


def tell(text: str) -> None:
    """Print to stderr without buffering; stdout has the command's result only."""
    print(f"note: {text}", file=sys.stderr, flush=True)
