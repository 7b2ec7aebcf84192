"""Tokens of a generated model's C to expressions, statements and declarations.

For what the generator writes and nothing more; anything else is refused. Shares no code with the
generator and needs the standard library only.
"""

import re
from collections.abc import Sequence
from typing import Any

from zerodrift.verify.c_nodes import CNode, Function, Program, TypeName, Variable
from zerodrift.verify.c_reader import FUNCTIONS, Tokens, parse_integer
from zerodrift.verify.c_values import TYPES, NotUnderstoodError

BINARY = {"||": 1, "&&": 2, "|": 3, "^": 4, "&": 5, "==": 6, "!=": 6}
BINARY |= {"<": 7, ">": 7, "<=": 7, ">=": 7, "<<": 8, ">>": 8, "+": 9, "-": 9}
BINARY |= {"*": 10, "/": 10, "%": 10}
ASSIGNMENTS = ("=", "+=", "-=", "*=", "|=", "&=", "^=", "<<=", ">>=")
WORDS = {"return", "if", "else", "for", "const", "static", "volatile", "typedef", "struct"}
WORDS |= {"while", "do", "goto", "switch", "case", "break", "continue", "union", "enum", "extern"}
WORDS |= {"inline", "sizeof", "void", "register", "auto", "restrict", "default"}
NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


def parse(tokens: Tokens, struct_types: Sequence[str]) -> Program:
    """Read all declarations.

    Args:
        tokens: of header and source, macros replaced.
        struct_types: the runtime's structs.

    Raises:
        NotUnderstoodError: something without a rule.
    """
    parser = Parser(tokens, struct_types)
    while parser.at < len(tokens.words):
        parser.read_declaration()
    return parser.program


class Parser:
    """Stands before a token and takes what follows."""

    def __init__(self, tokens: Tokens, struct_types: Sequence[str]) -> None:
        """Stand before the first token."""
        self.program, self.at = Program(tokens), 0
        self._words = tokens.words
        self._declared: dict[str, list[Any]] = {}
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

    # --- declarations

    def read_declaration(self) -> None:
        """Read one declaration at file level."""
        if self.look() == "ZD_CLAIM":
            self._read_claim()
            return
        if self.take_if("typedef"):
            self._read_struct()
            return
        static = self.take_if("static")
        start = self.at
        kind = self._read_type()
        name = self.take_name()
        if self.look() == "(":
            self._read_function(kind, name)
            return
        if not (static and kind.constant) or kind.pointer or kind.volatile:
            raise self.error(f"{name} is no constant of this file")
        if any(name == other.name for other in self.program.constants):
            raise self.error(f"{name} stands here twice")
        sizes = self._read_sizes()
        if self.take_if("__attribute__"):  # keeps a table in a program; nothing else is known
            self.take_all("(", "(", "used", ")", ")")
        self.take("=")
        self.program.constants.append(Variable(kind, name, sizes, start, self._initialiser()))
        self.take(";")

    def _read_claim(self) -> None:
        self.take("ZD_CLAIM")
        self.take("(")
        self.take_name()
        self.take(",")
        self.program.claims.append(self.expression())
        self.take(")")
        self.take(";")

    def _read_struct(self) -> None:
        self.take("struct")
        self.take("{")
        fields: list[Variable] = []
        while not self.take_if("}"):
            start, kind = self.at, self._read_type()
            name = self.take_name()
            fields.append(Variable(kind, name, self._read_sizes(), start))
            if kind.name not in TYPES or kind.pointer or kind.constant or kind.volatile:
                raise self.error(f"{name} is no plain number")
            self.take(";")
        name = self.take_name()
        self.take(";")
        if name in self._types or len({f.name for f in fields}) != len(fields):
            raise self.error(f"{name} stands here twice")
        self._types.add(name)
        self.program.structs[name] = tuple(fields)

    def _read_function(self, kind: TypeName, name: str) -> None:
        self.take("(")
        parameters: list[Variable] = []
        in_register, begin = False, self.at
        if self.look() == "void" and self.look(1) == ")":
            self.take()
        while not self.take_if(")"):
            start, of = self.at, self._read_type()
            parameters.append(Variable(of, self.take_name(), self._read_sizes(), start))
            in_register = self.take_if("ZD_IN_REGISTER") or in_register
            if self.look() != ")":
                self.take(",")
        words = [w for w in self._words[begin : self.at] if w != "ZD_IN_REGISTER"]
        if self._declared.setdefault(name, [kind, *words]) != [kind, *words]:
            raise self.error(f"{name} was declared with other parameters")
        naked = False
        if self.take_if("__attribute__"):
            self.take_all("(", "(", "naked", ",", "noinline", ",", "used", ")", ")")
            naked = True
        if self.take_if(";"):
            return
        if kind.pointer or (kind.name not in TYPES and kind.name != "void"):
            raise self.error(f"{name} returns no number")
        if name in self.program.functions or name in self.program.assembly:
            raise self.error(f"{name} stands here twice")
        if self.look(1) in ("__asm", "__asm__") and not naked:
            self._read_assembly(name)
            return
        if naked or in_register:
            raise self.error(f"{name} is no function in C")
        self.program.functions[name] = Function(name, kind.name, tuple(parameters), self.block())

    def _read_assembly(self, name: str) -> None:
        """A function that is one statement of assembly, which c_assembly knows or not."""
        lines: list[str] = []
        self.take("{")
        self.take("__asm")
        self.take("volatile")
        self.take("(")
        while not self.take_if(")"):
            word = self.take()
            if word[0] != '"' and not re.fullmatch(r"ZD_TANH_\w+_NAME", word):
                raise self.error(f"'{word}' in assembly")
            lines.append(word)
        self.take(";")
        self.take("}")
        self.program.assembly[name] = tuple(lines)

    def _read_type(self) -> TypeName:
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

    def _read_sizes(self) -> tuple[CNode, ...]:
        sizes = []
        while self.take_if("["):
            sizes.append(self.expression())
            self.take("]")
        return tuple(sizes)

    def _initialiser(self) -> CNode:
        start = self.at
        if not self.take_if("{"):
            return self.expression()
        if (numbers := self._plain_numbers()) is not None:
            return CNode("numbers", start, (numbers,))
        items = []
        while not self.take_if("}"):
            items.append(self._initialiser())
            if self.look() != "}":
                self.take(",")
        return CNode("list", start, tuple(items))

    def _plain_numbers(self) -> list[int] | None:
        """Read a list of decimal numbers and its brace at once; stay where it is none."""
        try:
            end = self._words.index("}", self.at)
        except ValueError:
            return None
        numbers, sign, open_ = [], 1, True
        for word in self._words[self.at : end]:
            if open_ and word == "-" and sign == 1:
                sign = -1
            elif open_ and word.isdigit() and (word[0] != "0" or word == "0"):
                numbers.append(sign * int(word))
                sign, open_ = 1, False
            elif not open_ and word == ",":
                open_ = True
            else:
                return None
        if not numbers or sign < 0:
            return None
        self.at = end + 1
        return numbers

    # --- statements

    def block(self) -> CNode:
        """Read statements in braces."""
        start = self.at
        self.take("{")
        statements = []
        while not self.take_if("}"):
            statements.append(self.statement())
        return CNode("block", start, tuple(statements))

    def statement(self) -> CNode:
        """Read one statement."""
        start, word = self.at, self.look()
        if word == "{":
            return self.block()
        if word == "if":
            return self._branch()
        if word == "for":
            return self._loop()
        if self.take_if("return"):
            value = None if self.look() == ";" else self.expression()
            self.take(";")
            return CNode("return", start, (value,))
        if word in ("const", "volatile") or (word in self._types and word != "void"):
            kind, name = self._read_type(), self.take_name()
            sizes = self._read_sizes()
            first = self._initialiser() if self.take_if("=") else None
            self.take(";")
            return CNode("declare", start, (Variable(kind, name, sizes, start, first),))
        if word == "(" and self.look(1) == "void":
            self.take_all("(", "void", ")")
            value = self.expression()
            self.take(";")
            return CNode("discard", start, (value,))
        return self._expression_statement()

    def _expression_statement(self) -> CNode:
        start = self.at
        target = self._unary()
        if self.look() in ASSIGNMENTS:
            operator = self.take()
            value = self.expression()
            self.take(";")
            return CNode("assign", start, (operator, target, value))
        if self.take_if("++"):
            self.take(";")
            return CNode(
                "assign", start, ("+=", target, CNode("integer", start, ("1", 1, False, 0)))
            )
        self.take(";")
        if target.kind != "call":
            raise self.error("a statement without effect")
        return CNode("call_alone", start, (target,))

    def _branch(self) -> CNode:
        start = self.at
        self.take("if")
        self.take("(")
        condition = self.expression()
        self.take(")")
        then, other = self.block(), None
        if self.take_if("else"):
            other = self._branch() if self.look() == "if" else self.block()
        return CNode("if", start, (condition, then, other))

    def _loop(self) -> CNode:
        """for (TYPE i = a; i < b; i++) { ... }, and nothing else."""
        start = self.at
        self.take("for")
        self.take("(")
        kind, name = self._read_type(), self.take_name()
        self.take("=")
        first = self.expression()
        self.take(";")
        condition = self.expression()
        self.take(";")
        self.take(name)
        self.take("++")
        self.take(")")
        body = self.block()
        own = condition.kind == "binary" and condition.parts[1] == CNode(
            "name", condition.parts[1].at, (name,)
        )
        if not own or condition.parts[0] not in ("<", "<=") or kind.name != "uint32_t":
            raise self.error("a loop that does not count up to a limit")
        return CNode("for", start, (kind.name, name, first, *condition.parts[::2], body))

    # --- expressions

    def expression(self) -> CNode:
        """Read an expression without assignments and commas."""
        start = self.at
        condition = self._binary(0)
        if not self.take_if("?"):
            return condition
        first = self.expression()
        self.take(":")
        return CNode("choose", start, (condition, first, self.expression()))

    def _binary(self, floor: int) -> CNode:
        start, left = self.at, self._unary()
        while BINARY.get(self.look(), 0) > floor:
            operator = self.take()
            left = CNode("binary", start, (operator, left, self._binary(BINARY[operator])))
        return left

    def _unary(self) -> CNode:
        start, word = self.at, self.look()
        if word in ("-", "+", "~", "!", "&", "*"):
            self.take()
            return CNode("unary", start, (word, self._unary()))
        if word == "sizeof":
            self.take()
            self.take("(")
            if self.look() in self._types:
                of: Any = self.take()
            else:
                of = self._unary()
            self.take(")")
            return CNode("sizeof", start, (of,))
        if word == "(" and (self.look(1) in self._types or self.look(1) == "const"):
            self.take()
            kind = self._read_type()
            self.take(")")
            return CNode("cast", start, (kind, self._unary()))
        return self._postfix()

    def _postfix(self) -> CNode:
        start = self.at
        if self.take_if("("):
            node = self.expression()
            self.take(")")
        elif self.look()[:1].isdigit() or self.look()[:1] == ".":
            token = self.take()
            node = CNode("integer", start, (token, *parse_integer(token)))
        else:
            name = self.take() if self.look() in FUNCTIONS else self.take_name()
            node = CNode("name", start, (name,))
            if self.take_if("("):
                arguments = []
                while not self.take_if(")"):
                    arguments.append(self.expression())
                    if self.look() != ")":
                        self.take(",")
                node = CNode("call", start, (name, tuple(arguments)))
        while self.look() in ("[", "->", "."):
            operator = self.take()
            if operator == "[":
                node = CNode("index", start, (node, self.expression()))
                self.take("]")
            else:
                node = CNode("field", start, (node, operator, self.take_name()))
        return node
