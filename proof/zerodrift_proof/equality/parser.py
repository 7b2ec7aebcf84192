"""Words of a model and its runtime to expressions, statements and declarations.

Words of C to expressions, for the proof: what generator and runtime write, and nothing more.

Source: C99, 6.5 (precedence of operators), 7.18.4 (INT64_C and others).

A model's own files hold functions of its names, constants, the structs of its header and the claims
of its sums. What they give a name to bears none of C's, a compiler's or the runtime's, and no name
hides another one.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from zerodrift_proof.equality.reader import AGAIN, RefusedError, is_runtime, read_integer
from zerodrift_proof.equality.syntax import (
    TYPES,
    Expression,
    Initialiser,
    PAlone,
    PAssign,
    PBinary,
    PBlock,
    PCall,
    PCast,
    PChoose,
    PDeclare,
    PField,
    PFunction,
    PIf,
    PIndex,
    PInteger,
    PList,
    PName,
    PNumbers,
    PProgram,
    PReturn,
    PSizeof,
    PTokens,
    PTyped,
    PTypeName,
    PUnary,
    PVariable,
    PWhile,
    Statement,
)

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
