"""Tokens of a model and its runtime to declarations: what the checker's parser reads, and more.

The runtime has loops of any kind, structs that point to tables, inline functions.
"""

from collections.abc import Sequence

from zerodrift.verify.c_nodes import (
    CAssign,
    CBlock,
    CDeclare,
    CInteger,
    CWhile,
    Expression,
    Program,
    Statement,
    Variable,
)
from zerodrift.verify.c_parser import ASSIGNMENTS, Parser
from zerodrift.verify.c_reader import Tokens


def parse_all(tokens: Tokens, struct_types: Sequence[str] = ()) -> Program:
    """Read all declarations of a model and its runtime.

    Raises:
        NotUnderstoodError: something without a rule.
    """
    parser = WholeParser(tokens, struct_types)
    while parser.at < len(tokens.words):
        parser.read_declaration()
    return parser.program


class WholeParser(Parser):
    """Takes what a plain C99 compiler sees of model and runtime."""

    def read_declaration(self) -> None:
        """Read one declaration at file level."""
        if self.look() == "typedef" and self.look(1) == "char":
            self.take_all("typedef", "char")
            self.take_name()
            self.take("[")
            self.program.claims.append(self.expression())
            self.take_all("]", ";")
            return
        if self.look() == "static" and self.look(1) == "inline":
            self.take()
            self.take()
        super().read_declaration()

    def _read_struct(self) -> None:
        self.take("struct")
        self.take("{")
        fields: list[Variable] = []
        while not self.take_if("}"):
            start, kind = self.at, self.read_type()
            name = self.take_name()
            fields.append(Variable(kind, name, self._read_sizes(), start))
            self.take(";")
        name = self.take_name()
        self.take(";")
        if name in self._types or len({f.name for f in fields}) != len(fields):
            raise self.error(f"{name} stands here twice")
        self._types.add(name)
        self.program.structs[name] = tuple(fields)

    def statement(self) -> Statement:
        """Read one statement."""
        start = self.at
        if self.take_if(";"):
            return CBlock(start, ())
        if self.look() == "while":
            self.take_all("while", "(")
            condition = self.expression()
            self.take(")")
            return CWhile(start, condition, self.block())
        if self.look() == "for":
            return self._any_loop()
        return super().statement()

    def _any_loop(self) -> Statement:
        start = self.at
        self.take_all("for", "(")
        before: list[Statement] = []
        if not self.take_if(";"):
            kind, name = self.read_type(), self.take_name()
            self.take("=")
            before.append(CDeclare(start, Variable(kind, name, (), start, self.expression())))
            self.take(";")
        condition = self.expression()
        self.take(";")
        step = self._step()
        self.take(")")
        body = self.block()
        inner = CBlock(body.at, (body, step))
        return CBlock(start, (*before, CWhile(start, condition, inner)))

    def _expression_statement(self) -> Statement:  # type: ignore[override]
        found = self._step()
        self.take(";")
        return found

    def _step(self) -> Statement:
        """An assignment, ++, -- or a call."""
        start = self.at
        target = self.unary()
        if self.look() in ASSIGNMENTS:
            operator = self.take()
            return CAssign(start, operator, target, self.expression())
        for word, operator in (("++", "+="), ("--", "-=")):
            if self.take_if(word):
                return CAssign(start, operator, target, CInteger(start, "1", 1))
        return self._alone(start, target)

    def _alone(self, start: int, target: Expression) -> Statement:
        from zerodrift.verify.c_nodes import CAlone, CCall

        if not isinstance(target, CCall):
            raise self.error("a statement without effect")
        return CAlone(start, target)
