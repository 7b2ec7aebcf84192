"""Characters of C to tokens, for the proof: what the generator never writes is refused.

Refused in a model's own files, each with file, line and column: characters beyond ASCII's printed
ones, tabs and carriage returns; trigraphs, digraphs and joined lines; character constants, string
prefixes and escapes but \\n; comments to the end of a line, and comments within comments; numbers
with another suffix than u, octal ones and fractions. A compiler that reads such text may see other
tokens than these rules do. The runtime's files, whose text is known by its hash, may join lines
and hold character constants as well.

Source: C99, 5.1.1.2 (phases of translation) and 6.4. Needs the standard library only.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

NAME, NUMBER, TEXT, CHARACTER, SIGN = "name", "number", "text", "character", "sign"
SIGNS = (
    *("<<=", ">>=", "->", "++", "--", "<<", ">>", "<=", ">=", "==", "!=", "&&", "||"),
    *("+=", "-=", "*=", "|=", "&=", "^="),
    *"{}[]();,.&*+-~!/%<>^|?:=#",
)
"""Punctuators that the generator and the runtime write."""
REFUSED = ("%:%:", "...", "<:", ":>", "<%", "%>", "%:", "##", "/=", "%=")
"""Punctuators of C99 that they do not; digraphs among them."""
TRIGRAPH = re.compile(r"\?\?[=/'()!<>-]")
JOINED = re.compile(r"\\[ \t\f\v\r]*\n")
"""gcc and clang join lines over spaces behind the backslash, too."""
INTEGER = re.compile(r"(?:0|[1-9][0-9]*|0x[0-9A-Fa-f]+)u?")


def _any_of(signs: Sequence[str]) -> str:
    return "|".join(re.escape(sign) for sign in sorted(signs, key=len, reverse=True))


SCANNER = re.compile(
    r"(?P<line>\n)|(?P<space> +)|(?P<joined>\\\n)|(?P<rest>//)|(?P<comment>/\*.*?\*/)|(?P<open>/\*)"
    rf"|(?P<{NAME}>[A-Za-z_][A-Za-z0-9_]*)"
    rf"|(?P<{NUMBER}>\.?[0-9](?:[eEpP][+-]|[A-Za-z0-9_.])*)"
    rf'|(?P<{TEXT}>"(?:[ !#-\[\]-~]|\\n)*")'
    rf"|(?P<{CHARACTER}>'[ -&(-\[\]-~]')"
    rf"|(?P<refused>{_any_of(REFUSED)})"
    rf"|(?P<{SIGN}>{_any_of(SIGNS)})",
    re.S,
)
QUOTE = "'"
STRANGE = {
    QUOTE: "a character constant",
    '"': "a text that does not end on its line, or with an escape other than \\n",
    "\\": "a backslash",
    "\t": "a tab",
    "\r": "a carriage return",
}


AGAIN = (
    "The generator never writes this, so that the proof has no rule for it: run `zerodrift"
    " firmware` again"
)


class RefusedError(Exception):
    """The C holds something that the generator never writes; nothing is claimed of it."""


@dataclass(frozen=True, slots=True)
class Token:
    """A token of C, and where it stands."""

    kind: str
    """name | number | text | character | sign."""
    text: str
    place: str
    """file:line:column; line and column count from 1."""
    spaced: bool = True
    """Whether white space or a comment stands before it."""


Line = tuple[Token, ...]


class Scanner:
    """Splits one file."""

    def __init__(self, text: str, file: str, known: bool) -> None:
        """Stand at the beginning of a text.

        Args:
            text: of the file, each line's end as it is stored.
            file: its name, for places.
            known: whether it is a file of the runtime.
        """
        self._text, self._file, self._known = text, file, known
        self._row, self._begin = 1, 0

    def split(self) -> Iterator[Line]:
        """Yield the lines that hold a token; of lines that are joined, the whole.

        Raises:
            RefusedError: a character or token that is never written.
        """
        self._refuse_anywhere()
        found: list[Token] = []
        at, spaced = 0, True
        while at < len(self._text):
            match = SCANNER.match(self._text, at)
            if match is None:
                raise self._error(at, self._name_strange(at))
            kind, word = str(match.lastgroup), match[0]
            if kind in (NAME, NUMBER, TEXT, CHARACTER, SIGN):
                self._check(kind, word, at)
                place = f"{self._file}:{self._row}:{at - self._begin + 1}"
                found.append(Token(kind, word, place, spaced))
                spaced = False
            else:
                spaced = True
                self._check_between(kind, word, at)
                if kind == "line" and found:
                    yield tuple(found)
                    found = []
            rows = word.count("\n") if kind in ("line", "comment", "joined") else 0
            if rows:
                self._row, self._begin = self._row + rows, at + word.rindex("\n") + 1
            at = match.end()
        if found or (self._text and self._text[-1] != "\n"):
            raise self._error(len(self._text), "the file does not end with a line")

    def _refuse_anywhere(self) -> None:
        """Refuse what is replaced before there are comments and texts."""
        for pattern, what in ((TRIGRAPH, "a trigraph"), (JOINED, "a line joined with the next")):
            for match in pattern.finditer(self._text):
                if pattern is TRIGRAPH or not self._known:
                    raise self._error(match.start(), what)
        for at, letter in enumerate(self._text) if not self._text.isascii() else ():
            if not letter.isascii():
                raise self._error(at, f"{letter!r}, a letter beyond ASCII")
        if strange := re.search(r"[^\n -~]", self._text):
            at = strange.start()
            raise self._error(at, STRANGE.get(self._text[at], "a control character"))

    def _check(self, kind: str, word: str, at: int) -> None:
        if kind == NAME and self._text[at + len(word) : at + len(word) + 1] in ("'", '"'):
            raise self._error(at, f"'{word}' before a quotation mark")
        if self._known:
            return
        if kind == CHARACTER:
            raise self._error(at, STRANGE[QUOTE])
        if kind == NUMBER and not INTEGER.fullmatch(word):
            raise self._error(at, f"'{word}' is no whole number as the generator writes it")

    def _check_between(self, kind: str, word: str, at: int) -> None:
        if kind == "rest":
            raise self._error(at, "a comment to the end of the line")
        if kind == "open":
            raise self._error(at, "a comment that does not end")
        if kind == "refused":
            raise self._error(at, f"'{word}'")
        if kind == "comment" and ("/*" in word[2:] or JOINED.search(word)):
            raise self._error(at, "a comment within a comment, or a joined line in one")

    def _name_strange(self, at: int) -> str:
        letter = self._text[at]
        return STRANGE.get(letter, f"'{letter}'")

    def _error(self, at: int, what: str) -> RefusedError:
        row = self._text.count("\n", 0, at) + 1
        column = at - (self._text.rfind("\n", 0, at) + 1) + 1
        return RefusedError(f"{self._file}:{row}:{column}: {what}. {AGAIN}")


@lru_cache(maxsize=64)
def split(text: str, file: str, known: bool) -> tuple[Line, ...]:
    """Return the lines of a file that hold a token.

    Args:
        text: of the file.
        file: its name, for places.
        known: whether it is a file of the runtime, the text of which is known by its hash.

    Raises:
        RefusedError: a character or token that is never written; with file, line and column.
    """
    return tuple(Scanner(text, file, known).split())
