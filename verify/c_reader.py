"""Reads the C of a generated model: its tokens, constants, state fields and functions.

A small parser for what the generator writes and nothing more; anything else is refused. Shares no
code with the generator and needs the standard library only.
"""

import re
from dataclasses import dataclass
from typing import Any

TYPES = {f"int{n}_t": (-(2 ** (n - 1)), 2 ** (n - 1) - 1) for n in (8, 16, 32, 64)}
TYPES |= {f"uint{n}_t": (0, 2**n - 1) for n in (8, 16, 32, 64)}
TABLES = ("zd_tanh_table.h", "zd_exp2.h", "zd_runtime.c")
"""Files with the runtime's tables; older runtimes have them in the last one."""
TOKEN = re.compile(r'\d+u?|[A-Za-z_]\w*|"[^"]*"|->|\+\+|<<|>>|&&|\|\||[-+*/&|<>=!]=|\S', re.ASCII)
DIRECTIVE = re.compile(
    r'#\s*(include "\w+\.h"|include <std\w+\.h>|error .*'
    r"|define \w+_H|define ZD_OBSERVE\(values, count\)"
    r"|define ZD_QUIET\(on\)"
    r"|define [A-Z]\w*_SAVED_BYTES \(16u \+ sizeof\(\w+_state_t\)\)"
    r"|define ZD_CLAIM\(name, holds\) typedef char name\[\(holds\) \? 1 : -1\]"
    r'|define (\w+) ("[\w.]+"|-?\d+|UINT32_C\(\d+\)))'
)
CONDITION = re.compile(
    r"#(if ZD_RUNTIME_FORMAT != \d+|if ZD_RUNTIME_ID != 0x\w{8}"
    r"|if \w+_CODE_ID != UINT32_C\(\d+\)|ifndef (?:ZD_OBSERVE|\w+_H)"
    r"|(?:el)?if ZD_KERNEL == (ZD_KERNEL_[A-Z]+)"
    r"|if \(ZD_KERNEL == ZD_KERNEL_PAIRS\) && defined\(ZD_GRU_ASSEMBLY\)"
    r"|if ZD_GRU_ASSEMBLY == 6|if defined\((?:ZD_GRU_ASSEMBLY|ZD_SMALL|ZD_UNALIGNED)\)|else|endif)"
)


class NotUnderstoodError(Exception):
    """The C holds something for which there is no rule; nothing can then be claimed of it."""


@dataclass(frozen=True)
class Value:
    """All numbers from low to high, of a C type; no partial sum behind them goes beyond `reach`."""

    low: int
    high: int
    type: str = "int32_t"
    reach: int = 0
    place: str = ""
    """The field of the state that was read, if it was."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "reach", max(self.reach, abs(self.low), abs(self.high)))

    def join(self, other: "Value") -> "Value":
        """Return what either can be."""
        reach = max(self.reach, other.reach)
        return Value(min(self.low, other.low), max(self.high, other.high), self.type, reach)


@dataclass
class Array:
    """Cells, the first of which stands for all where `shared` (a field of the state)."""

    cells: list[Any]
    size: int
    shared: bool = False
    place: str = ""
    whole: "Array | None" = None
    """Of which this is the part from `first` on."""
    first: int = 0

    def rest(self, first: int) -> "Array":
        """Return the array from an element on; what is filled in there is filled in here."""
        self.at(Value(first, first))
        cells = self.cells if self.shared else self.cells[first:]
        return Array(cells, self.size - first, self.shared, self.place, self, first)

    def fill(self, value: Value, count: int) -> None:
        """Let the first `count` cells be anything that `value` is."""
        self.hold(count)
        if self.shared:
            self.cells = [value]
            return
        self.cells = [value] * count + self.cells[count:]
        if self.whole is not None:
            self.whole.cells[self.first : self.first + count] = [value] * count

    def hold(self, count: int) -> None:
        """Raise IndexError where the array has less than `count` elements."""
        if count > self.size:
            raise IndexError(f"{count} elements of an array of {self.size}")

    def at(self, index: Value) -> list[int]:
        """Return the positions in `cells` that an index can mean."""
        if index.low < 0 or index.high >= self.size:
            raise IndexError(f"index {index.low} .. {index.high} of an array of {self.size}")
        return [0] if self.shared else list(range(index.low, index.high + 1))

    def flat(self) -> list[Any]:
        """Return all elements, `shared` ones repeated."""
        cells = self.cells * self.size if self.shared else self.cells
        return [v for cell in cells for v in (cell.flat() if isinstance(cell, Array) else [cell])]


def make_array(kind: str, sizes: list[int], low: int, high: int, place: str = "") -> Any:
    """Return a value or (nested) array of a type, every element anywhere from low to high."""
    value: Any = Value(low, high, kind, place="" if sizes else place)
    for size in reversed(sizes):
        value = Array([value], size, shared=True, place=place)
    return value


class Code:
    """What a model's header and source declare."""

    def __init__(
        self, texts: dict[str, str], prefix: str, kernel: str = "ZD_KERNEL_PORTABLE"
    ) -> None:
        """Read `prefix`.h and `prefix`.c, and the constants and tables of zd_runtime.h and .c.

        Args:
            texts: file name -> content.
            prefix: of the model.
            kernel: for which of its kernels the model is compiled; never the assembly.
        """
        self.prefix, self.kernel = prefix, kernel
        self.tokens: list[str] = []
        self.places: list[str] = []
        self.macros = {
            name: int(value)
            for name, value in re.findall(r"#define (ZD_\w+) (\d+)\b", texts["zd_runtime.h"])
        }
        self.constants: dict[str, Any] = {}
        self.functions: dict[str, tuple[list[tuple[str, str]], int]] = {}
        """Name -> parameters (type, name) and where its body begins."""
        self.structs: dict[str, dict[str, tuple[str, list[int]]]] = {}
        runtime = re.sub(r"/\*.*?\*/", "", "".join(texts.get(n, "") for n in TABLES), flags=re.S)
        self.tables = {
            name: [int(n) for n in numbers.split(",")]
            for name, numbers in re.findall(r"(\w+)\[[\w +]+\] = \{([-\d,\s]*)\}", runtime)
        }
        """The runtime's tables."""
        for name in (f"{prefix}.h", f"{prefix}.c"):
            self._tokenize(texts[name], name)
        self.close: dict[int, int] = {}
        opened: list[int] = []
        for at, token in enumerate(self.tokens):
            if token in ("{", "("):
                opened.append(at)
            elif token in ("}", ")"):
                self.close[opened.pop()] = at
        at = 0
        while at < len(self.tokens):
            at = self._read_declaration(at)

    def _tokenize(self, text: str, name: str) -> None:
        def blank(match: re.Match[str]) -> str:
            return "\n" * match[0].count("\n")

        text = re.sub(r"/\*.*?\*/", blank, text, flags=re.S)
        text = re.sub(r"#ifdef __cplusplus\n[^#]*#endif", blank, text)
        active, taken = [True], [True]  # per nested condition: this branch, any branch so far
        for number, line in enumerate(text.split("\n"), 1):
            condition = CONDITION.fullmatch(line.strip())
            if condition:
                self._branch(condition, active, taken)
                continue
            if not all(active):
                continue
            if line.lstrip().startswith("#"):
                known = DIRECTIVE.fullmatch(line.strip())
                macro = known[2] if known else None
                own = not macro or macro.startswith(f"{self.prefix.upper()}_")
                if not known or not own or macro in self.macros:
                    raise NotUnderstoodError(f"{name}:{number}: {line.strip()}")
                if macro and '"' not in known[3]:
                    self.macros[macro] = int(re.findall(r"-?\d+", known[3])[-1])
                continue
            found = TOKEN.findall(line)
            self.tokens += found
            self.places += [f"{name}:{number}"] * len(found)

    def _branch(self, condition: re.Match[str], active: list[bool], taken: list[bool]) -> None:
        """Follow a condition of the preprocessor for this kernel."""
        word = condition[1].split()[0]
        if word == "endif":
            active.pop()
            taken.pop()
        elif word == "else":
            active[-1] = not taken[-1]
        else:
            true = word == "ifndef" or condition[2] == self.kernel
            if word != "elif":
                active.append(False)
                taken.append(False)
            active[-1] = true and not taken[-1]
            taken[-1] = taken[-1] or true

    def _read_declaration(self, at: int) -> int:
        """Read one declaration at file level; return where the next begins."""
        end = at
        while self.tokens[end] not in ("(", "[", "=", ";", "{"):
            end += 1
        words = self.tokens[at:end]
        if words[:2] == ["typedef", "struct"]:
            close = self.close[end]
            self.structs[self.tokens[close + 1]] = self._read_fields(end + 1, close)
            return close + 3
        if words[0] != "typedef" and self.tokens[end] == "(":
            close = self.close[end]
            if self.tokens[close + 1] == "{":
                self.functions[words[-1]] = (self._read_parameters(end + 1, close), close + 1)
                return self.close[close + 1] + 1
        while self.tokens[end] not in (";", "="):
            end = self.close.get(end, end) + 1
        if self.tokens[end] == "=":
            value, end = self.read_initialiser(end + 1, words[-2])
            if isinstance(value, Array):
                value.place = words[-1]
            self.constants[words[-1]] = value
        return end + 1

    def read_initialiser(self, at: int, kind: str) -> tuple[Any, int]:
        """Return the constant, array of constants or names from token `at` on, and its end."""
        if self.tokens[at] == "{":
            items: list[Any] = []
            at += 1
            while self.tokens[at] != "}":
                item, at = self.read_initialiser(at, kind)
                items.append(item)
                at += self.tokens[at] == ","
            return Array(items, len(items)), at + 1
        end = at
        while self.tokens[end] not in (",", "}", ";"):
            end += 1
        text = "".join(self.tokens[at:end]).replace("INT64_C", "")
        if not re.fullmatch(r"[-()\d]+", text):
            return text, end
        value = sum(int(n) for n in re.findall(r"-?\d+", text))  # the lowest is written as a sum
        return Value(value, value, kind), end

    def _read_fields(self, at: int, end: int) -> dict[str, tuple[str, list[int]]]:
        line = " ".join(self.tokens[at:end])
        found = re.findall(r"(\w+) (\w+) ((?:\[ \w+ \] )*);", line)
        return {
            name: (kind, [self.macros.get(n) or int(n) for n in re.findall(r"\w+", sizes)])
            for kind, name, sizes in found
        }

    def _read_parameters(self, at: int, end: int) -> list[tuple[str, str]]:
        parts = " ".join(self.tokens[at:end]).split(" , ")
        plain = [re.sub(r"const |\* | \[.*", "", part).split() for part in parts]
        return [(words[0], words[-1]) for words in plain if words != ["void"]]
