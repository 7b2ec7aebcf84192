"""Reads the C of a generated model: every way that its preprocessor can take, and its tokens.

For what the generator writes and nothing more; anything else is refused. Shares no code with the
generator and needs the standard library only.
"""

import itertools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from zerodrift.verify.c_values import FaultError, NotUnderstoodError

TOKEN = re.compile(
    r'"(?:\\.|[^"\\\n])*"|\.?\d(?:[eEpP][+-]|[\w.])*|[A-Za-z_]\w*'
    r"|->|\+\+|--|<<=|>>=|<<|>>|&&|\|\||[-+*/%&|^<>=!]=|\S",
    re.ASCII,
)
COMMENT = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"', re.S)
INTEGER = re.compile(r"(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)([uU]?)([lL]{0,2})([uU]?)")

WAYS: dict[str, tuple[int | None, ...]] = {
    "ZD_KERNEL": (0, 1, 2, 3),
    "ZD_GRU_ASSEMBLY": (None, 6, 7),
    "ZD_ASSEMBLY": (None, 6, 7),
    "ZD_SMALL": (None, 1),
    "ZD_UNALIGNED": (None, 1),
    "ZD_OBSERVE": (None,),
    "__cplusplus": (None,),
}
"""What a build may define, and as what; None: not at all. ZD_OBSERVE is the test harness's."""
KERNELS = ("PORTABLE", "PAIRS", "ROWS", "COLUMNS")
FUNCTIONS = {
    "ZD_OBSERVE": "(values, count)",
    "ZD_QUIET": "(on)",
    "ZD_CLAIM": "(name, holds) typedef char name[(holds) ? 1 : -1]",
}
"""Macros with parameters; they are not replaced, there are rules for them."""
CONDITIONS = {"||": 1, "&&": 2, "==": 3, "!=": 3}
IN_CPLUSPLUS = ('extern "C" {', "}")
LIMITS = {f"INT{n}_MIN": -(2 ** (n - 1)) for n in (8, 16, 32, 64)}
LIMITS |= {f"INT{n}_MAX": 2 ** (n - 1) - 1 for n in (8, 16, 32, 64)}
LIMITS |= {f"UINT{n}_MAX": 2**n - 1 for n in (8, 16, 32, 64)}


@dataclass(frozen=True)
class Line:
    """A line without its comments."""

    place: str
    """file:line."""
    tokens: tuple[str, ...]
    text: str

    @property
    def directive(self) -> str:
        """The word after #, or nothing."""
        return self.tokens[1] if self.tokens[0] == "#" and len(self.tokens) > 1 else ""


@dataclass(frozen=True)
class PreprocessorWay:
    """One way through all conditions of the preprocessor."""

    defined: Mapping[str, int]
    lines: tuple[Line, ...]

    @property
    def name(self) -> str:
        """What a build of this kind defines."""
        words = []
        for macro, value in self.defined.items():
            if macro == "ZD_KERNEL":
                words.append(f"ZD_KERNEL_{KERNELS[value]}")
            else:
                words.append(macro if value == 1 else f"{macro} {value}")
        return ", ".join(words)


@dataclass
class Tokens:
    """The tokens of header and source with all macros of the model replaced."""

    words: list[str] = field(default_factory=list)
    places: list[str] = field(default_factory=list)
    macros: dict[str, list[str]] = field(default_factory=dict)


def parse_integer(token: str) -> tuple[int, bool, int]:
    """Return a literal's number as C reads it, whether it is unsigned, and its count of l.

    Raises:
        NotUnderstoodError: C has no such integer.
    """
    found = INTEGER.fullmatch(token)
    if not found or (found[2] and found[4]) or found[3] in ("lL", "Ll"):
        raise NotUnderstoodError(f"'{token}' is no integer of C")
    digits = found[1]
    octal = digits[0] == "0" and digits[1:2] not in ("x", "X")
    return int(digits, 8 if octal else 0), bool(found[2] or found[4]), len(found[3])


def split_lines(text: str, name: str) -> list[Line]:
    """Return the lines of a file that hold anything, without comments."""
    if "??" in text or re.search(r"\\[ \t]*\r?\n", text) or not text.isascii():
        raise NotUnderstoodError(f"{name}: a trigraph, a continued line or a letter beyond ASCII")

    def blank(match: re.Match[str]) -> str:
        return match[0] if match[0][0] == '"' else " " + "\n" * match[0].count("\n")

    lines = []
    for number, line in enumerate(COMMENT.sub(blank, text).split("\n"), 1):
        tokens = tuple(TOKEN.findall(line))
        if tokens:
            lines.append(Line(f"{name}:{number}", tokens, line.strip()))
    return lines


def read_ways(
    texts: Mapping[str, str], prefix: str, known: Mapping[str, int]
) -> list[tuple[PreprocessorWay, Tokens]]:
    """Return every different text that the preprocessor can make of header and source.

    Args:
        texts: file name -> content.
        prefix: of the model.
        known: macros of the runtime that are numbers.

    Raises:
        NotUnderstoodError: a condition or macro without a rule.
    """
    lines = [
        line
        for end in ("h", "c")
        for line in split_lines(texts[f"{prefix}.{end}"], f"{prefix}.{end}")
    ]
    used = {
        token
        for line in lines
        if line.directive in ("if", "elif", "ifdef", "ifndef")
        for token in line.tokens
    }
    free = [name for name in WAYS if name in used]
    found: dict[tuple[Line, ...], PreprocessorWay] = {}
    for values in itertools.product(*(WAYS[name] for name in free)):
        defined = {n: v for n, v in zip(free, values, strict=True) if v is not None}
        if not _is_possible(defined, free):
            continue
        taken = tuple(_follow(lines, defined, known, prefix))
        found.setdefault(taken, PreprocessorWay(defined, taken))
    return [(way, _replace_macros(way, prefix, known)) for way in found.values()]


def _is_possible(defined: Mapping[str, int], free: list[str]) -> bool:
    """Tell whether the runtime can define all of this together, as far as it is asked for."""
    kernel, of_gru = defined.get("ZD_KERNEL"), defined.get("ZD_GRU_ASSEMBLY")
    assembly = defined.get("ZD_ASSEMBLY")
    if of_gru and kernel not in (None, 1):
        return False  # ZD_KERNEL=... overrides; this assembly is the pairs kernel's alone
    if not assembly:
        return not (of_gru and "ZD_ASSEMBLY" in free)
    return kernel in (None, 1) and ("ZD_GRU_ASSEMBLY" not in free or of_gru == assembly)


def _follow(
    lines: list[Line], defined: Mapping[str, int], known: Mapping[str, int], prefix: str
) -> Iterator[Line]:
    """Yield the lines that a compiler sees, directives but conditions included."""
    own: dict[str, int | None] = {}
    active, taken, skipped = [True], [True], [False]
    for line in lines:
        word = line.directive
        if word in ("if", "ifdef", "ifndef", "elif", "else", "endif"):
            if word in ("if", "ifdef", "ifndef"):
                outside = all(active)
                true = outside and _holds(line, defined, known, own, prefix)
                active.append(true)
                taken.append(true or not outside)
                skipped.append("__cplusplus" in line.tokens)
                continue
            if len(active) < 2:
                raise NotUnderstoodError(f"{line.place}: {line.text} without #if")
            if word == "endif":
                for stack in (active, taken, skipped):
                    stack.pop()
                continue
            true = not taken[-1] and (word == "else" or _holds(line, defined, known, own, prefix))
            active[-1], taken[-1] = true, taken[-1] or true
            continue
        if skipped[-1] and line.text not in IN_CPLUSPLUS:
            raise NotUnderstoodError(f"{line.place}: {line.text} for C++ alone")
        if not all(active):
            continue
        if word == "define" and len(line.tokens) > 2:
            body = [t for t in line.tokens[3:] if t not in ("UINT32_C", "(", ")")]
            is_number = len(body) == 1 and body[0][0].isdigit()
            own[line.tokens[2]] = parse_integer(body[0])[0] if is_number else None
        yield line
    if len(active) != 1:
        raise NotUnderstoodError(f"{lines[-1].place}: an #if without #endif")


def _holds(
    line: Line,
    defined: Mapping[str, int],
    known: Mapping[str, int],
    own: Mapping[str, int | None],
    prefix: str,
) -> bool:
    """Evaluate a condition."""

    def is_defined(name: str) -> int:
        if name in WAYS:
            return int(name in defined or name in own)
        if name in known or name in own:
            return 1
        if name.startswith(f"{prefix.upper()}_"):
            return 0
        raise NotUnderstoodError(f"{line.place}: no rule for whether {name} is defined")

    words = list(line.tokens[2:])
    if line.directive in ("ifdef", "ifndef"):
        if len(words) != 1:
            raise NotUnderstoodError(f"{line.place}: {line.text}")
        return is_defined(words[0]) == (line.directive == "ifdef")

    def take(expected: str = "") -> str:
        if not words or (expected and words[0] != expected):
            raise NotUnderstoodError(f"{line.place}: {line.text}")
        return words.pop(0)

    def single() -> int:
        word = take()
        if word == "!":
            return int(not single())
        if word == "(":
            value = compound(0)
            take(")")
            return value
        if word == "defined":
            if words[:1] != ["("]:
                return is_defined(take())
            take("(")
            value = is_defined(take())
            take(")")
            return value
        if word == "UINT32_C":
            return single()
        if word[0].isdigit():
            return parse_integer(word)[0]
        of_build = {**dict.fromkeys(WAYS, 0), **known, **defined}  # 0: as C takes an unknown name
        number = own.get(word) if word in own else of_build.get(word)
        if number is None:
            raise NotUnderstoodError(f"{line.place}: no rule for {word} in {line.text}")
        return number

    def compound(floor: int) -> int:
        left = single()
        while words and CONDITIONS.get(words[0], 0) > floor:
            operator = take()
            right = compound(CONDITIONS[operator])
            left = int(
                {
                    "||": bool(left or right),
                    "&&": bool(left and right),
                    "==": left == right,
                    "!=": left != right,
                }[operator]
            )
        return left

    result = compound(0)
    if words:
        raise NotUnderstoodError(f"{line.place}: {line.text}")
    return bool(result)


def _replace_macros(way: PreprocessorWay, prefix: str, known: Mapping[str, int]) -> Tokens:
    """Return what is left to compile: no directive, and no macro of the model."""
    found, included = Tokens(), set[str]()
    for line in way.lines:
        word = line.directive
        if word == "error":
            raise FaultError(f"{line.place}: does not compile: {line.text}")
        if line.tokens[0] != "#":
            if f"{prefix}.c:" in line.place and not {"zd_runtime.h", f"{prefix}.h"} <= included:
                raise NotUnderstoodError(f"{line.place}: something before the files it needs")
            for token in line.tokens:
                words = found.macros.get(token, [token])
                found.words += words
                found.places += [line.place] * len(words)
        elif word == "include":
            file = line.text.split(None, 1)[1].removeprefix("include").strip(' "<>')
            if file not in ("stddef.h", "stdint.h", f"{prefix}.h") and not re.fullmatch(
                r"zd_\w+\.h", file
            ):
                raise NotUnderstoodError(f"{line.place}: {line.text}")
            included.add(file)
        elif word == "define":
            _define(line, found, prefix, known)
        else:
            raise NotUnderstoodError(f"{line.place}: {line.text}")
    return found


def _define(line: Line, found: Tokens, prefix: str, known: Mapping[str, int]) -> None:
    """Take a macro, the value of which has its own macros replaced already."""
    name, words = line.tokens[2], line.tokens[3:]
    if name in FUNCTIONS:
        if line.text.replace(" ", "") != f"#define{name}{FUNCTIONS[name]}".replace(" ", ""):
            raise NotUnderstoodError(f"{line.place}: {line.text}")
        return
    if re.search(rf"\b{name}\(", line.text):
        raise NotUnderstoodError(f"{line.place}: a macro with parameters, {line.text}")
    if not name.startswith(f"{prefix.upper()}_") or name in known or name in found.macros:
        raise NotUnderstoodError(f"{line.place}: {line.text}")
    found.macros[name] = [w for word in words for w in found.macros.get(word, [word])]
