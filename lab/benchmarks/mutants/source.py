"""One shipped file as the operators see it: its text, its code without comments, its functions."""

import re
from dataclasses import dataclass
from functools import cached_property

_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_STRING = re.compile(r'"(?:[^"\\\n]|\\.)*"')
_FUNCTION = re.compile(r"^(?!typedef|#)[a-z][\w *]*?\b(\w+)\([^;{}]*\)\s*\{", re.MULTILINE)


@dataclass(frozen=True)
class Span:
    """Characters start to end of a file, with the name of the function they make up."""

    name: str
    start: int
    end: int


@dataclass(frozen=True)
class Source:
    """A file of the firmware folder."""

    name: str
    text: str

    @cached_property
    def commentless(self) -> str:
        """The text with its comments blanked, every character at its place."""
        return _COMMENT.sub(_blank, self.text)

    @cached_property
    def code(self) -> str:
        """The text with comments, strings, observations and claims blanked."""
        code = _STRING.sub(_blank, self.commentless)
        return re.sub(r"(?m)^\s*(?:ZD_OBSERVE|ZD_CLAIM)\(.*$", _blank, code)

    @cached_property
    def functions(self) -> list[Span]:
        """The functions' bodies, in order."""
        found = []
        for match in _FUNCTION.finditer(self.code):
            depth, at = 1, match.end()
            while depth and at < len(self.code):
                depth += {"{": 1, "}": -1}.get(self.code[at], 0)
                at += 1
            found.append(Span(match[1], match.end(), at - 1))
        return found

    def find_in_functions(self, pattern: str) -> list[re.Match[str]]:
        """Return all matches that lie in functions and not on a preprocessor's line."""
        compiled = re.compile(pattern)
        found = [
            match
            for span in self.functions
            for match in compiled.finditer(self.code, span.start, span.end)
        ]
        return [match for match in found if not self.is_directive(match.start())]

    def is_directive(self, at: int) -> bool:
        """Say whether a place is on a line that the preprocessor reads, its continuations too."""
        line = self.text.rfind("\n", 0, at) + 1
        while line > 1 and self.text[line - 2] == "\\":
            line = self.text.rfind("\n", 0, line - 1) + 1
        return self.text[line:].lstrip().startswith("#")

    def count_lines(self, at: int) -> int:
        """Return the number of the line of a place, from 1 on."""
        return self.text.count("\n", 0, at) + 1


def _blank(match: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", match[0])
