"""Words of a model and its runtime to declarations and statements, for the proof.

A model's own files hold functions of its names, constants, the structs of its header and the claims
of its sums. What they give a name to bears none of C's, a compiler's or the runtime's, and no name
hides another one.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from zerodrift_proof.equality.expressions import PExpressionParser
from zerodrift_proof.equality.syntax import (
    Expression,
    Initialiser,
    PAlone,
    PAssign,
    PBlock,
    PCall,
    PDeclare,
    PFunction,
    PIf,
    PInteger,
    PList,
    PNumbers,
    PProgram,
    PReturn,
    PTokens,
    PTypeName,
    PVariable,
    PWhile,
    Statement,
)
from zerodrift_proof.equality.types import TYPES

ASSIGNMENTS = ("=", "+=", "-=", "*=", "|=", "&=", "^=", "<<=", ">>=")
NAKED = ("__attribute__", "(", "(", "naked", ",", "noinline", ",", "used", ")", ")")
LAYER_ENDS = ("_step", "_relax", "_is_sound", "_assembly")
"""Functions of a node end so; all others begin with the model's prefix."""
OBSERVING = ("ZD_OBSERVE", "ZD_QUIET")
TABLE_NAME = re.compile(r"ZD_(?:TANH|SIGMOID)_\w+_NAME")
"""In assembly: the linker's name of a table of the runtime."""


def parse_all(tokens: PTokens, prefix: str) -> PProgram:
    """Read all declarations of a model and its runtime.

    Args:
        tokens: of the model's source and all that it includes.
        prefix: of the model.

    Raises:
        RefusedError: something without a rule.
    """
    parser = PParser(tokens, prefix)
    while parser.at < len(tokens.words):
        parser.read_declaration()
    return parser.program


class PParser(PExpressionParser):
    """Takes statements and declarations."""

    def __init__(self, tokens: PTokens, prefix: str, struct_types: Sequence[str] = ()) -> None:
        """Stand before the first word."""
        super().__init__(tokens, struct_types)
        self._prefix = prefix
        self._scopes: list[set[str]] = [set()]
        """Names of the file, and of each block that this stands in."""
        self._static: set[str] = set()
        """Functions that no other file sees."""

    # --- names

    def _name_new(self) -> str:
        """Take a name that is given to something; in a model's file it hides no other."""
        name = self.take_new()
        hidden = self._scopes[-1:] if self.in_runtime else self._scopes
        if any(name in scope for scope in hidden):
            self.at -= 1
            raise self.error(f"'{name}' is given to something a second time")
        self._scopes[-1].add(name)
        return name

    @contextmanager
    def _scope(self) -> Iterator[None]:
        self._scopes.append(set())
        yield
        self._scopes.pop()

    # --- declarations

    def read_declaration(self) -> None:
        """Read one declaration at file level."""
        if self.look() == "ZD_CLAIM":
            self._read_claim()
        elif self.look() == "typedef":
            self._read_typedef()
        else:
            self._read_object()

    def _read_claim(self) -> None:
        self.take_all("ZD_CLAIM", "(")
        if not self._name_new().startswith(f"{self._prefix}_"):
            raise self.error("a claim that is not named after the model")
        self.take(",")
        self.program.claims.append(self.expression())
        self.take_all(")", ";")

    def _read_typedef(self) -> None:
        self.take("typedef")
        if self.in_runtime and self.take_if("char"):
            self._name_new()
            self.take("[")
            self.program.claims.append(self.expression())
            self.take_all("]", ";")
            return
        self.take_all("struct", "{")
        fields: list[PVariable] = []
        while not self.take_if("}"):
            start, kind = self.at, self.read_type()
            name = self.take_new()
            if any(name == field.name for field in fields):
                raise self.error(f"a field {name} a second time")
            fields.append(PVariable(kind, name, self._read_sizes(), start))
            self.take(";")
        name = self._name_new()
        self.take(";")
        self._types.add(name)
        self.program.structs[name] = tuple(fields)

    def _read_object(self) -> None:
        in_runtime = self.in_runtime
        static = self.take_if("static")
        if static and in_runtime:
            self.take_if("inline")
        start = self.at
        kind = self.read_type()
        if self.look(1) == "(":
            self._read_function(kind, static)
            return
        name = self._name_new()
        if not (static and kind.constant) or kind.pointer or kind.volatile:
            raise self.error(f"{name} is no constant of this file")
        sizes = self._read_sizes()
        self.take("=")
        self.program.constants.append(PVariable(kind, name, sizes, start, self._initialiser()))
        self.take(";")

    def _read_function(self, kind: PTypeName, static: bool) -> None:
        in_runtime, name = self.in_runtime, self.take_new()
        if not in_runtime:
            self._check_function(name, static)
        with self._scope():
            start = self.at
            parameters, in_register = self._read_parameters()
            words = " ".join(w for w in self._words[start : self.at] if w != "ZD_IN_REGISTER")
            told = f"{kind.name}{' *' * kind.pointer} {words}"
            if self.program.declared.setdefault(name, told) != told:
                raise self.error(f"{name} was declared otherwise")
            naked = self.look() == NAKED[0]
            if naked:
                self.take_all(*NAKED)
            if self.take_if(";"):
                return
            if name in self.program.functions or name in self.program.assembly:
                raise self.error(f"a function {name} a second time")
            if self.look(1) == "__asm" and in_register:
                self._read_assembly(name)
                return
            if naked or in_register or not (kind.pointer or kind.name in {*TYPES, "void"}):
                raise self.error(f"{name} is no function in C")
            body = PBlock(self.at, tuple(self._read_braces()))
        self.program.functions[name] = PFunction(name, kind.name, tuple(parameters), body)

    def _check_function(self, name: str, static: bool) -> None:
        """A function of a model's file is one of the header's, or none that others see."""
        own = name.startswith(f"{self._prefix}_")
        if not own and not name.endswith(LAYER_ENDS):
            raise self.error(f"{name} is no function of the model or of a layer")
        if name not in self.program.declared:
            if name in self._scopes[0]:
                raise self.error(f"'{name}' is given to something a second time")
            self._scopes[0].add(name)
            if static:
                self._static.add(name)
            elif self._is_in_header():
                self.program.public.add(name)
            else:
                raise self.error(f"{name} is not static, and not in the header")
        if static != (name in self._static):
            raise self.error(f"{name} is static in one place alone")

    def _is_in_header(self) -> bool:
        place = self.program.tokens.places[self.at]
        return place.startswith(f"{self._prefix}.h:")

    def _read_parameters(self) -> tuple[list[PVariable], bool]:
        """Return the parameters, and whether all of them are in registers, for assembly."""
        self.take("(")
        parameters: list[PVariable] = []
        registers = 0
        if self.look() == "void" and self.look(1) == ")":
            self.take_all("void", ")")
            return [], False
        while not parameters or not self.take_if(")"):
            if parameters:
                self.take(",")
            start, kind = self.at, self.read_type()
            parameters.append(PVariable(kind, self._name_new(), self._read_sizes(), start))
            registers += self.take_if("ZD_IN_REGISTER")
        return parameters, registers == len(parameters)

    def _read_assembly(self, name: str) -> None:
        """A function that is one statement of assembly, of which the object code is proven."""
        lines: list[str] = []
        self.take_all("{", "__asm", "volatile", "(")
        while not self.take_if(")"):
            word = self.take()
            if word[0] != '"' and not TABLE_NAME.fullmatch(word):
                raise self.error(f"'{word}' in assembly")
            lines.append(word)
        self.take_all(";", "}")
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
            return PNumbers(start, numbers)
        items: list[Initialiser] = []
        while not items or not self.take_if("}"):
            if items:
                self.take(",")
            items.append(self._initialiser())
        return PList(start, tuple(items))

    def _plain_numbers(self) -> list[int] | None:
        """Read a list of decimal numbers and its brace at once; stay where it is none."""
        numbers, sign, at = [], 1, self.at
        words, count = self._words, len(self._words)
        while at + 1 < count:
            word, after = words[at], words[at + 1]
            if word == "-" and sign == 1:
                sign, at = -1, at + 1
                continue
            if not word.isdigit() or (word[0] == "0" and word != "0") or after not in (",", "}"):
                return None
            numbers.append(sign * int(word))
            sign, at = 1, at + 2
            if after == "}":
                self.at = at
                return numbers
        return None

    # --- statements

    def block(self) -> PBlock:
        """Read statements in braces, with names of their own."""
        start = self.at
        with self._scope():
            return PBlock(start, tuple(self._read_braces()))

    def _read_braces(self) -> list[Statement]:
        self.take("{")
        statements = []
        while not self.take_if("}"):
            statements.append(self.statement())
        return statements

    def statement(self) -> Statement:
        """Read one statement."""
        start, word = self.at, self.look()
        if word == "{":
            return self.block()
        if word == "if":
            return self._branch()
        if word == "for":
            return self._loop()
        if word in (";", "while") and self.in_runtime:
            return self._of_runtime()
        if word in OBSERVING and not self.in_runtime:
            return self._observe()
        if self.take_if("return"):
            value = None if self.look() == ";" else self.expression()
            self.take(";")
            return PReturn(start, value)
        if self.begins_type():
            kind, name = self.read_type(), self._name_new()
            sizes = self._read_sizes()
            first = self._initialiser() if self.take_if("=") else None
            self.take(";")
            return PDeclare(start, PVariable(kind, name, sizes, start, first))
        if word == "(" and self.look(1) == "void":
            self.take_all("(", "void", ")")
            unused = self.expression()
            self.take(";")
            return PAlone(start, unused)
        found = self._step()
        self.take(";")
        return found

    def _of_runtime(self) -> Statement:
        start = self.at
        if self.take_if(";"):
            return PBlock(start, ())
        self.take_all("while", "(")
        condition = self.expression()
        self.take(")")
        return PWhile(start, condition, self.block())

    def _observe(self) -> Statement:
        """What is nothing but in the test harness."""
        start = self.at
        self.take()
        self.take("(")
        self.expression()
        if self.take_if(","):
            self.expression()
        self.take_all(")", ";")
        return PBlock(start, ())

    def _branch(self) -> PIf:
        start = self.at
        self.take_all("if", "(")
        condition = self.expression()
        self.take(")")
        then = self.block()
        other: PBlock | PIf | None = None
        if self.take_if("else"):
            other = self._branch() if self.look() == "if" else self.block()
        return PIf(start, condition, then, other)

    def _loop(self) -> Statement:
        """for (TYPE i = a; i < b; i++) { ... } as the loop that C says it is."""
        start, in_runtime = self.at, self.in_runtime
        self.take_all("for", "(")
        before: list[Statement] = []
        with self._scope():
            if not (in_runtime and self.take_if(";")):
                kind, name = self.read_type(), self._name_new()
                self.take("=")
                before.append(PDeclare(start, PVariable(kind, name, (), start, self.expression())))
                self.take(";")
            condition = self.expression()
            self.take(";")
            step = self._step()
            self.take(")")
            body = self.block()
        inner = PBlock(body.at, (body, step))
        return PBlock(start, (*before, PWhile(start, condition, inner)))

    def _step(self) -> Statement:
        """An assignment, ++ or a call."""
        start = self.at
        target = self.unary()
        if self.look() in ASSIGNMENTS:
            operator = self.take()
            return PAssign(start, operator, target, self.expression())
        for word, operator in (("++", "+="), ("--", "-=")):
            if self.take_if(word):
                return PAssign(start, operator, target, PInteger(start, "1", 1))
        if not isinstance(target, PCall):
            raise self.error("a statement without effect")
        return PAlone(start, target)
