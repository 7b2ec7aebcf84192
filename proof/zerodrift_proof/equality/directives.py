"""The lines of a model's own files that begin with #: those that the generator writes, no others.

A compiler defines macros that no list is complete of, so a condition may ask for the generator's
own alone. Macros that are defined belong to the model and stand for one number or text; each is
defined once. What C++ alone sees, and what the test harness alone defines, is one fixed text.
"""

import re
from dataclasses import dataclass
from enum import Enum

from zerodrift_proof.equality.tokens import AGAIN, NUMBER, TEXT, Line, RefusedError

HEADER = (
    "# include < stdint . h >",
    "# include < stddef . h >",
    "# ifdef __cplusplus",
    "# endif",
    "# ifndef P_H",
    "# define P_H",
    r"# define P_\w+ (?:Nu?|UINT32_C \( N \)|S|\( Nu \+ sizeof \( p_state_t \) \))",
)
"""Patterns of the header's lines: N is a number, Nu one with a u, S a text, P and p the prefix."""
SOURCE = (
    "# include S",
    "# error S",
    r"# if (?:P_CODE_ID|ZD_RUNTIME_FORMAT|ZD_RUNTIME_ID) != Nx?",
    "# ifndef ZD_OBSERVE",
    r"# define ZD_OBSERVE \( values , count \)",
    r"# define ZD_QUIET \( on \)",
    r"# define ZD_CLAIM \( name , holds \) typedef char name \[ \( holds \) \? N : - N \]",
    r"# (?:if|elif) ZD_KERNEL == ZD_KERNEL_(?:PAIRS|ROWS|COLUMNS)",
    r"# (?:if|elif) ZD_ASSEMBLY (?:==|!=) N",
    r"# if ZD_GRU_ASSEMBLY == N",
    r"# if \( ZD_KERNEL == ZD_KERNEL_PAIRS \) && defined \( ZD_GRU_ASSEMBLY \)",
    r"# if (?:! )?defined \( (?:ZD_SMALL|ZD_UNALIGNED|ZD_GRU_ASSEMBLY) \)",
    "# else",
    "# endif",
)
"""The same of the source."""
CPLUSPLUS = ('extern "C" {', "}")
CLAIM = ("typedef", "char", "name", "[", "(", "holds", ")", "?", "1", ":", "-", "1", "]")
FUNCTIONS = ("ZD_OBSERVE", "ZD_QUIET", "ZD_CLAIM")
"""Macros with parameters."""
FREE = ("ZD_KERNEL", "ZD_GRU_ASSEMBLY", "ZD_ASSEMBLY", "ZD_SMALL", "ZD_UNALIGNED")
"""What a build may choose, that a model's file may ask for."""


class Behind(Enum):
    """What a condition asks for, which tells what may stand between it and its #endif."""

    GUARD = "#ifndef PREFIX_H"
    CPLUSPLUS = "#ifdef __cplusplus"
    """One of two lines."""
    OBSERVE = "#ifndef ZD_OBSERVE"
    """Macros of the test harness, as they are without it."""
    NUMBER = "a number of the runtime or the header"
    """#error, and nothing else."""
    WAY = "a way to build"
    """Anything; #elif and #else too."""


@dataclass
class Group:
    """The lines between a condition and its #endif."""

    behind: Behind
    lines: int = 0
    """Without those of conditions."""
    ended: bool = False
    """Whether #else was."""


class OwnFile:
    """A file of the model: its lines of tokens."""

    def __init__(self, name: str, prefix: str, lines: tuple[Line, ...]) -> None:
        """Stand before the first line.

        Args:
            name: of the file.
            prefix: of the model.
            lines: of the file.
        """
        self._name, self._prefix, self._lines = name, prefix, lines
        self._groups: list[Group] = []
        self._open: list[str] = []
        """The word before each round bracket that is open."""
        self._before = ""
        self._defined: set[str] = set()

    def check(self) -> None:
        """Look at every line that begins with #, whether a build reads it or not.

        Raises:
            RefusedError: one that the generator never writes.
        """
        is_header = self._name.endswith(".h")
        patterns = [re.compile(text) for text in (HEADER if is_header else SOURCE)]
        if is_header:
            self._check_guard()
        for line in self._lines:
            if any(token.text == "#" for token in line[1:]):
                raise refuse(line, "a # within a line")
            if line[0].text != "#":
                self._take_code(line)
                continue
            text = self._tell(line)
            if not any(pattern.fullmatch(text) for pattern in patterns):
                raise refuse(line, f"'{_join(line)}'")
            if self._open and self._open[0] != "volatile":  # of assembly; others may be a macro's
                raise refuse(line, "a line that begins with # within brackets")
            self._follow(line, text)
        if self._groups:
            raise refuse(self._lines[-1], "the end of the file before an #endif")

    def _tell(self, line: Line) -> str:
        """Return a line with numbers, texts and the model's prefix in their general form."""
        lower, upper = f"{self._prefix}_", f"{self._prefix.upper()}_"
        words = []
        for token in line:
            word = token.text
            if token.kind == NUMBER:
                word = "N" + "u" * word.endswith("u") + "x" * word.startswith("0x")
            elif token.kind == TEXT:
                word = "S"
            elif word.startswith(upper):
                word = f"P_{word.removeprefix(upper)}"
            elif word.startswith(lower):
                word = f"p_{word.removeprefix(lower)}"
            words.append(word)
        return " ".join(words)

    def _check_guard(self) -> None:
        """The whole header stands between #ifndef PREFIX_H, #define PREFIX_H and #endif."""
        name, lines = f"{self._prefix.upper()}_H", self._lines
        found = [_join(lines[k]) for k in (0, 1, -1)] if len(lines) > 2 else []
        if found != [f"# ifndef {name}", f"# define {name}", "# endif"]:
            raise RefusedError(f"{self._name}:1:1: a header without its {name} around all. {AGAIN}")

    def _take_code(self, line: Line) -> None:
        for token in line:
            if token.text == "(":
                self._open.append(self._before)
            elif token.text == ")" and self._open:
                self._open.pop()
            self._before = token.text
        if not self._groups:
            return
        group = self._groups[-1]
        group.lines += 1
        alone = group.behind is Behind.CPLUSPLUS and _join(line) in CPLUSPLUS and group.lines == 1
        if not alone and group.behind not in (Behind.GUARD, Behind.WAY):
            raise refuse(line, f"code behind {group.behind.value}")

    def _follow(self, line: Line, text: str) -> None:
        word, group = line[1].text, self._groups[-1] if self._groups else Group(Behind.WAY)
        if word in ("if", "ifdef", "ifndef"):
            if group.behind not in (Behind.GUARD, Behind.WAY):
                raise refuse(line, f"a condition behind {group.behind.value}")
            self._groups.append(Group(self._find_kind(line, text)))
        elif not self._groups and word in ("elif", "else", "endif"):
            raise refuse(line, f"#{word} without its #if")
        elif word in ("elif", "else"):
            if group.behind is not Behind.WAY or group.ended:
                raise refuse(line, f"#{word} behind {group.behind.value}, or behind #else")
            group.ended = word == "else"
        elif word == "endif":
            if group.behind is Behind.GUARD and line is not self._lines[-1]:
                raise refuse(line, "the header's last #endif before its end")
            self._groups.pop()
        elif word == "error":
            group.lines += 1
            if group.behind is not Behind.NUMBER or group.lines > 1:
                raise refuse(line, "#error where no number is asked for")
        elif word == "define":
            self._define(line, group)
        elif group.behind is not Behind.GUARD and self._groups:
            raise refuse(line, "#include behind a condition")

    def _find_kind(self, line: Line, text: str) -> Behind:
        if text == "# ifndef P_H":
            if line is not self._lines[0]:
                raise refuse(line, "the header's guard a second time")
            return Behind.GUARD
        for kind, begin in ((Behind.CPLUSPLUS, "# ifdef __"), (Behind.OBSERVE, "# ifndef ZD_")):
            if text.startswith(begin):
                return kind
        is_number = re.match("# if (?:P_|ZD_RUNTIME_)", text)
        return Behind.NUMBER if is_number else Behind.WAY

    def _define(self, line: Line, group: Group) -> None:
        name, is_function = line[2].text, len(line) > 3 and not line[3].spaced
        if name in self._defined:
            raise refuse(line, f"{name} is defined again")
        if is_function != (name in FUNCTIONS):
            raise refuse(line, f"how {name} is defined")
        if name == "ZD_CLAIM" and tuple(token.text for token in line[8:]) != CLAIM:
            raise refuse(line, f"how {name} is defined")
        in_header = self._name.endswith(".h")
        wanted = Behind.GUARD if in_header else Behind.OBSERVE
        if name == "ZD_CLAIM":
            if self._groups:
                raise refuse(line, f"{name} is defined behind a condition")
        elif not self._groups or group.behind is not wanted:
            raise refuse(line, f"{name} is defined elsewhere than behind {wanted.value}")
        self._defined.add(name)


def _join(line: Line) -> str:
    return " ".join(token.text for token in line)


def refuse(line: Line, what: str) -> RefusedError:
    """Return the error of a line that the generator never writes."""
    return RefusedError(f"{line[0].place}: {what}. {AGAIN}")
