"""Tokens of a generated model's C to expressions.

For what the generator writes and nothing more; anything else is refused. Shares no code with the
generator and needs the standard library only.
"""

import re
from collections.abc import Sequence

from zerodrift.verify.c_lexer import parse_integer
from zerodrift.verify.c_nodes import (
    CBinary,
    CCall,
    CCast,
    CChoose,
    CField,
    CIndex,
    CInteger,
    CName,
    CSizeof,
    CUnary,
    Expression,
    PlacedWords,
    Program,
    TypeName,
    are_alike,
    walk,
)
from zerodrift.verify.c_values import TYPES, NotUnderstoodError

BINARY = {"||": 1, "&&": 2, "|": 3, "^": 4, "&": 5, "==": 6, "!=": 6}
BINARY |= {"<": 7, ">": 7, "<=": 7, ">=": 7, "<<": 8, ">>": 8, "+": 9, "-": 9}
BINARY |= {"*": 10, "/": 10, "%": 10}
FUNCTIONS = ("ZD_OBSERVE", "ZD_QUIET", "ZD_CLAIM")
"""Macros with parameters; they are not replaced, there are rules for them."""
WORDS = {"return", "if", "else", "for", "const", "static", "volatile", "typedef", "struct"}
WORDS |= {"while", "do", "goto", "switch", "case", "break", "continue", "union", "enum", "extern"}
WORDS |= {"inline", "sizeof", "void", "register", "auto", "restrict", "default"}
NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


class ExpressionParser:
    """Stands before a token and takes what follows."""

    def __init__(self, tokens: PlacedWords, struct_types: Sequence[str]) -> None:
        """Stand before the first token."""
        self.program, self.at = Program(tokens), 0
        self._words = tokens.words
        self._types = {*TYPES, "unsigned", "void", *struct_types}

    # --- tokens

    def look(self, ahead: int = 0) -> str:
        """Return a token and stay."""
        at = self.at + ahead
        return self._words[at] if at < len(self._words) else ""

    def take(self, expected: str = "") -> str:
        """Return the token and go on."""
        token = self.look()
        if not token or (expected and token != expected):
            raise self.error(f"'{token}' where '{expected or 'more'}' was expected")
        self.at += 1
        return token

    def take_all(self, *expected: str) -> None:
        """Go on over these tokens."""
        for token in expected:
            self.take(token)

    def take_if(self, token: str) -> bool:
        """Go on if this is the token."""
        if self.look() != token:
            return False
        self.at += 1
        return True

    def take_name(self) -> str:
        """Return a name that is no word of C."""
        name = self.take()
        if not NAME.fullmatch(name) or name in WORDS or name in self._types:
            raise self.error(f"'{name}' where a name was expected")
        return name

    def error(self, what: str) -> NotUnderstoodError:
        """Return what to raise here."""
        return NotUnderstoodError(f"{self.program.place(self.at)}: {what}")

    # --- types

    def read_type(self) -> TypeName:
        """Take a type as it stands before a name."""
        constant = volatile = False
        while self.look() in ("const", "volatile"):
            word = self.take()
            if (constant and word == "const") or (volatile and word == "volatile"):
                raise self.error(f"{word} twice")
            constant, volatile = constant or word == "const", volatile or word == "volatile"
        name = self.take()
        if name not in self._types:
            raise self.error(f"'{name}' is no type that is known here")
        pointer = self.take_if("*")
        if pointer:
            self.take_if("const")
        return TypeName("uint32_t" if name == "unsigned" else name, constant, pointer, volatile)

    # --- expressions

    def expression(self) -> Expression:
        """Read an expression without assignments and commas."""
        start = self.at
        condition = self._binary(0)
        if not self.take_if("?"):
            return condition
        self.require_open(condition)
        first = self.expression()
        self.take(":")
        return CChoose(start, condition, first, self.expression())

    def _binary(self, floor: int) -> Expression:
        start, left = self.at, self.unary()
        while BINARY.get(self.look(), 0) > floor:
            operator = self.take()
            left = CBinary(start, operator, left, self._binary(BINARY[operator]))
        return left

    def require_open(self, condition: Expression) -> None:
        """Refuse a condition that compares nothing, or numbers alone: it goes one way only.

        Raises:
            NotUnderstoodError: a part of it is no comparison with something that has a name.
        """
        match condition:
            case CBinary(operator="&&" | "||"):
                self.require_open(condition.left)
                self.require_open(condition.right)
            case CBinary(operator="==" | "!=" | "<" | "<=" | ">" | ">="):
                named = (isinstance(part, CName | CCall) for part in walk(condition))
                if not any(named) or are_alike(condition.left, condition.right):
                    raise self.error("a comparison that goes one way only")
            case _:
                raise self.error("a condition that is no comparison")

    def unary(self) -> Expression:
        """Take an expression up to the first operator between two."""
        start, word = self.at, self.look()
        if word in ("-", "+", "~", "!", "&", "*"):
            self.take()
            return CUnary(start, word, self.unary())
        if word == "sizeof":
            self.take()
            self.take("(")
            of = self.take() if self.look() in self._types else self.unary()
            self.take(")")
            return CSizeof(start, of)
        if word == "(" and (self.look(1) in self._types or self.look(1) == "const"):
            self.take()
            kind = self.read_type()
            self.take(")")
            return CCast(start, kind, self.unary())
        return self._postfix()

    def _postfix(self) -> Expression:
        start = self.at
        if self.take_if("("):
            node: Expression = self.expression()
            self.take(")")
        elif self.look()[:1].isdigit() or self.look()[:1] == ".":
            token = self.take()
            node = CInteger(start, token, *parse_integer(token))
        else:
            name = self.take() if self.look() in FUNCTIONS else self.take_name()
            node = CName(start, name)
            if self.take_if("("):
                arguments = list[Expression]()
                while not self.take_if(")"):
                    if arguments:
                        self.take(",")
                    arguments.append(self.expression())
                node = CCall(start, name, tuple(arguments))
        while self.look() in ("[", "->", "."):
            operator = self.take()
            if operator == "[":
                node = CIndex(start, node, self.expression())
                self.take("]")
            else:
                node = CField(start, node, operator, self.take_name())
        return node
