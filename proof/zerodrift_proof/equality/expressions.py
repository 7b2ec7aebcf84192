"""Words of C to expressions, for the proof: what generator and runtime write, and nothing more.

Source: C99, 6.5 (precedence of operators), 7.18.4 (INT64_C and others).
"""

import re
from collections.abc import Sequence

from zerodrift_proof.equality.reader import is_runtime, read_integer
from zerodrift_proof.equality.syntax import (
    Expression,
    PBinary,
    PCall,
    PCast,
    PChoose,
    PField,
    PIndex,
    PInteger,
    PName,
    PProgram,
    PSizeof,
    PTokens,
    PTyped,
    PTypeName,
    PUnary,
)
from zerodrift_proof.equality.tokens import AGAIN, RefusedError
from zerodrift_proof.equality.types import TYPES

OPERATORS = (
    ("||",),
    ("&&",),
    ("|",),
    ("^",),
    ("&",),
    ("==", "!="),
    ("<", ">", "<=", ">="),
    ("<<", ">>"),
    ("+", "-"),
    ("*", "/", "%"),
)
"""From those that bind least to those that bind most; all from left to right."""
BINDING = {sign: level for level, signs in enumerate(OPERATORS, 1) for sign in signs}
KEYWORDS = frozenset(
    {
        *("auto", "break", "case", "char", "const", "continue", "default", "do"),
        *("double", "else", "enum", "extern", "float", "for", "goto", "if", "inline"),
        *("int", "long", "register", "restrict", "return", "short", "signed", "sizeof"),
        *("static", "struct", "switch", "typedef", "union", "unsigned", "void"),
        *("volatile", "while", "asm", "typeof"),
    }
)
RESERVED = re.compile(
    r"u?int\w*_t|(?:size|ptrdiff|wchar)_t|U?INT\w*_(?:MIN|MAX|C)|(?:SIZE|PTRDIFF|WCHAR|WINT"
    r"|SIG_ATOMIC)_M\w+|NULL|offsetof|_\w*|(?:zd|ZD)_\w*"
)
"""Names of C's headers, of compilers and of the runtime: a model's files give none of them to
anything."""
TYPED = {f"{kind.upper()}_C": f"{kind}_t" for kind in ("uint32", "int64", "uint64")}
NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


class PExpressionParser:
    """Stands before a word and takes what follows."""

    def __init__(self, tokens: PTokens, struct_types: Sequence[str] = ()) -> None:
        """Stand before the first word."""
        self.program, self.at = PProgram(tokens), 0
        self._words = tokens.words
        self._types = {*TYPES, "void", "size_t", "uintptr_t", *struct_types}

    # --- words

    def look(self, ahead: int = 0) -> str:
        """Return a word and stay."""
        at = self.at + ahead
        return self._words[at] if at < len(self._words) else ""

    def take(self, expected: str = "") -> str:
        """Return the word and go on."""
        word = self.look()
        if not word or (expected and word != expected):
            raise self.error(f"'{word}' where '{expected or 'more'}' was expected")
        self.at += 1
        return word

    def take_all(self, *expected: str) -> None:
        """Go on over these words."""
        for word in expected:
            self.take(word)

    def take_if(self, word: str) -> bool:
        """Go on if this is the word."""
        if self.look() != word:
            return False
        self.at += 1
        return True

    def take_name(self) -> str:
        """Return a name that is no word of C and no type."""
        name = self.take()
        unknown = name[0] == "_" and not self.in_runtime
        if not NAME.fullmatch(name) or name in KEYWORDS or name in self._types or unknown:
            self.at -= 1
            raise self.error(f"'{name}' where a name was expected")
        return name

    def take_new(self) -> str:
        """Return a name that is given to something here."""
        name = self.take_name()
        if not self.in_runtime and RESERVED.fullmatch(name):
            self.at -= 1
            raise self.error(f"'{name}' is a name of C, a compiler or the runtime")
        return name

    @property
    def in_runtime(self) -> bool:
        """Whether this stands in a file of the runtime."""
        places = self.program.tokens.places
        return self.at >= len(places) or is_runtime(places[self.at])

    def error(self, what: str) -> RefusedError:
        """Return what to raise here."""
        return RefusedError(f"{self.program.place(self.at)}: {what}. {AGAIN}")

    # --- types

    def read_type(self) -> PTypeName:
        """Take a type as it stands before a name."""
        said = []
        while self.look() in ("const", "volatile"):
            said.append(self.take())
        if len({*said}) != len(said):
            raise self.error(f"{said[-1]} twice")
        name = self.take()
        if name == "unsigned" and self.in_runtime:
            name = "uint32_t"
        elif name not in self._types:
            self.at -= 1
            raise self.error(f"'{name}' is no type that is known here")
        pointer = self.take_if("*")
        if pointer:
            self.take_if("const")
        return PTypeName(name, "const" in said, pointer, "volatile" in said)

    def begins_type(self, ahead: int = 0) -> bool:
        """Return whether a type stands here."""
        word = self.look(ahead)
        return word in self._types or word in ("const", "volatile", "unsigned")

    # --- expressions

    def expression(self) -> Expression:
        """Read an expression without assignments and commas."""
        start = self.at
        condition = self._binary(0)
        if not self.take_if("?"):
            return condition
        first = self.expression()
        self.take(":")
        return PChoose(start, condition, first, self.expression())

    def _binary(self, floor: int) -> Expression:
        start, left = self.at, self.unary()
        while BINDING.get(self.look(), 0) > floor:
            operator = self.take()
            left = PBinary(start, operator, left, self._binary(BINDING[operator]))
        return left

    def unary(self) -> Expression:
        """Take an expression up to the first operator between two."""
        start, word = self.at, self.look()
        if word in ("-", "+", "~", "!", "&", "*"):
            self.take()
            return PUnary(start, word, self.unary())
        if word == "sizeof":
            self.take_all("sizeof", "(")
            of = self.take() if self.look() in self._types else self.unary()
            self.take(")")
            return PSizeof(start, of)
        if word == "(" and self.begins_type(1):
            self.take("(")
            kind = self.read_type()
            self.take(")")
            return PCast(start, kind, self.unary())
        return self._postfix()

    def _postfix(self) -> Expression:
        node = self._primary()
        start = node.at
        while self.look() in ("[", "->", "."):
            operator = self.take()
            if operator == "[":
                node = PIndex(start, node, self.expression())
                self.take("]")
            else:
                node = PField(start, node, operator, self.take_name())
        return node

    def _primary(self) -> Expression:
        start = self.at
        if self.take_if("("):
            node = self.expression()
            self.take(")")
            return node
        if self.look()[:1].isdigit():
            word = self.take()
            return PInteger(start, word, read_integer(word), word.endswith("u"))
        if self.look() in TYPED:
            return self._read_typed()
        name = self.take_name()
        if not self.take_if("("):
            return PName(start, name)
        arguments: list[Expression] = []
        while not self.take_if(")"):
            if arguments:
                self.take(",")
            arguments.append(self.expression())
        return PCall(start, name, tuple(arguments))

    def _read_typed(self) -> PTyped:
        """INT64_C(n), whose n is joined with a suffix: one number without one, and its sign."""
        start = self.at
        kind = TYPED[self.take()]
        self.take("(")
        sign = -1 if kind == "int64_t" and self.take_if("-") else 1
        word = self.take()
        if not word[0].isdigit() or word.endswith("u"):
            raise self.error(f"'{word}' where one number without a suffix was expected")
        number = sign * read_integer(word)
        if abs(number) > TYPES[kind][1]:
            raise self.error(f"{number} is no {kind} as C writes it")
        self.take(")")
        return PTyped(start, number, kind)
