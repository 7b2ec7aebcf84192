"""Tokens of a generated model's C to statements and declarations.

For what the generator writes and nothing more; anything else is refused. Shares no code with the
generator and needs the standard library only.
"""

import re
from collections.abc import Sequence

from zerodrift.verify.c_nodes import (
    CAlone,
    CAssign,
    CBinary,
    CBlock,
    CCall,
    CDeclare,
    CFor,
    CIf,
    CInteger,
    CList,
    CNumbers,
    CReturn,
    Expression,
    Function,
    Initialiser,
    PlacedWords,
    Program,
    Statement,
    TypeName,
    Variable,
    is_name,
)
from zerodrift.verify.c_parse_expressions import ExpressionParser
from zerodrift.verify.c_values import TYPES

ASSIGNMENTS = ("=", "+=", "-=", "*=", "|=", "&=", "^=", "<<=", ">>=")


def parse(tokens: PlacedWords, struct_types: Sequence[str]) -> Program:
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


class Parser(ExpressionParser):
    """Takes statements and declarations."""

    def __init__(self, tokens: PlacedWords, struct_types: Sequence[str]) -> None:
        """Stand before the first token."""
        super().__init__(tokens, struct_types)
        self._declared: dict[str, tuple[TypeName, list[str]]] = {}

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
        kind = self.read_type()
        name = self.take_name()
        if self.look() == "(":
            self.program.declared.setdefault(name, start)
            if static:
                self.program.static.add(name)
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
        self.program.claim_names.append(self.take_name())
        self.take(",")
        self.program.claims.append(self.expression())
        self.take(")")
        self.take(";")

    def _read_struct(self) -> None:
        self.take("struct")
        self.take("{")
        fields: list[Variable] = []
        while not self.take_if("}"):
            start, kind = self.at, self.read_type()
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
        elif self.look() == ")":
            raise self.error(f"{name}: (void) is written where there are no parameters")
        while not self.take_if(")"):
            if parameters:
                self.take(",")
            start, of = self.at, self.read_type()
            parameters.append(Variable(of, self.take_name(), self._read_sizes(), start))
            in_register = self.take_if("ZD_IN_REGISTER") or in_register
        words = [w for w in self._words[begin : self.at] if w != "ZD_IN_REGISTER"]
        if self._declared.setdefault(name, (kind, words)) != (kind, words):
            raise self.error(f"{name} was declared with other parameters")
        self.program.signatures[name] = " ".join([kind.name, *words])
        naked = False
        if self.take_if("__attribute__"):
            self.take_all("(", "(", "naked", ",", "noinline", ",", "used", ")", ")")
            naked = True
            self.program.naked.add(name)
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
            if word[0] != '"' and not re.fullmatch(r"ZD_(TANH|SIGMOID)_\w+_NAME", word):
                raise self.error(f"'{word}' in assembly")
            lines.append(word)
        self.take(";")
        self.take("}")
        self.program.assembly[name] = tuple(lines)

    def _read_sizes(self) -> tuple[Expression, ...]:
        sizes = []
        while self.take_if("["):
            sizes.append(self.expression())
            self.take("]")
        return tuple(sizes)

    def _initialiser(self) -> Initialiser:
        start = self.at
        if not self.take_if("{"):
            return self.expression()
        if (numbers := self._plain_numbers()) is not None:
            return CNumbers(start, numbers)
        items = []
        while not self.take_if("}"):
            items.append(self._initialiser())
            if self.look() != "}":
                self.take(",")
        return CList(start, tuple(items))

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

    def block(self) -> CBlock:
        """Read statements in braces."""
        start = self.at
        self.take("{")
        statements = []
        while not self.take_if("}"):
            statements.append(self.statement())
        return CBlock(start, tuple(statements))

    def statement(self) -> Statement:
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
            return CReturn(start, value)
        if word in ("const", "volatile") or (word in self._types and word != "void"):
            kind, name = self.read_type(), self.take_name()
            sizes = self._read_sizes()
            first = self._initialiser() if self.take_if("=") else None
            self.take(";")
            return CDeclare(start, Variable(kind, name, sizes, start, first))
        if word == "(" and self.look(1) == "void":
            self.take_all("(", "void", ")")
            unused = self.expression()
            self.take(";")
            return CAlone(start, unused)
        return self._expression_statement()

    def _expression_statement(self) -> CAssign | CAlone:
        start = self.at
        target = self.unary()
        if self.look() in ASSIGNMENTS:
            operator = self.take()
            value = self.expression()
            self.take(";")
            return CAssign(start, operator, target, value)
        if self.take_if("++"):
            self.take(";")
            return CAssign(start, "+=", target, CInteger(start, "1", 1))
        self.take(";")
        if not isinstance(target, CCall):
            raise self.error("a statement without effect")
        return CAlone(start, target)

    def _branch(self) -> CIf:
        start = self.at
        self.take("if")
        self.take("(")
        condition = self.expression()
        self.require_open(condition)
        self.take(")")
        then = self.block()
        other: CBlock | CIf | None = None
        if self.take_if("else"):
            other = self._branch() if self.look() == "if" else self.block()
        return CIf(start, condition, then, other)

    def _loop(self) -> CFor:
        """for (TYPE i = a; i < b; i++) { ... }, and nothing else."""
        start = self.at
        self.take("for")
        self.take("(")
        kind, name = self.read_type(), self.take_name()
        self.take("=")
        first = self.expression()
        self.take(";")
        condition = self.expression()
        self.take(";")
        self.take(name)
        self.take("++")
        self.take(")")
        body = self.block()
        counted = (
            isinstance(condition, CBinary)
            and is_name(condition.left, name)
            and condition.operator in ("<", "<=")
        )
        if not isinstance(condition, CBinary) or not counted or kind.name != "uint32_t":
            raise self.error("a loop that does not count up to a limit")
        return CFor(start, kind.name, name, first, condition.operator, condition.right, body)
