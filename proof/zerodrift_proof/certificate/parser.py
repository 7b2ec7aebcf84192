"""What the C of a generated model is read into, and how: expressions, statements, declarations.

What the C of a generated model is read into: expressions, statements and declarations.

Tokens of a generated model's C to expressions.

For what the generator writes and nothing more; anything else is refused. Shares no code with the
generator and needs the standard library only.

For what the generator writes and nothing more; anything else is refused. Shares no code with the
generator and needs the standard library only.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

from zerodrift_proof.certificate.preprocessor import parse_integer
from zerodrift_proof.certificate.values import TYPES, NotUnderstoodError


class PlacedWords(Protocol):
    """What a program is read from: its words, where each stands, and macros by name."""

    @property
    def words(self) -> Sequence[str]:
        """All of them, in their order."""

    @property
    def places(self) -> Sequence[str]:
        """file:line of each, or file:line:column."""

    @property
    def macros(self) -> Mapping[str, Sequence[str]]:
        """Name -> the words that it stands for."""


@dataclass(frozen=True)
class CNode:
    """An expression, an initialiser or a statement."""

    at: int
    """The token with which it begins."""


@dataclass(frozen=True)
class TypeName:
    """A type as it is written before a name."""

    name: str
    constant: bool = False
    pointer: bool = False
    volatile: bool = False


@dataclass(frozen=True)
class Variable:
    """A declared variable, parameter or field; sizes and initialiser as expressions."""

    type: TypeName
    name: str
    sizes: "tuple[Expression, ...]"
    at: int
    first: "Initialiser | None" = None


@dataclass(frozen=True)
class CInteger(CNode):
    """A literal."""

    token: str
    number: int
    unsigned: bool = False
    longs: int = 0
    """How many l it ends with."""


@dataclass(frozen=True)
class CName(CNode):
    """A variable, a constant or a macro of the runtime."""

    name: str


@dataclass(frozen=True)
class CField(CNode):
    """of->name or of.name."""

    of: "Expression"
    operator: str
    name: str


@dataclass(frozen=True)
class CIndex(CNode):
    """of[index]."""

    of: "Expression"
    index: "Expression"


@dataclass(frozen=True)
class CCall(CNode):
    """name(arguments)."""

    name: str
    arguments: "tuple[Expression, ...]"


@dataclass(frozen=True)
class CUnary(CNode):
    """One of - + ~ ! & * before an expression."""

    operator: str
    of: "Expression"


@dataclass(frozen=True)
class CSizeof(CNode):
    """sizeof(of), a type's name or an expression."""

    of: "str | Expression"


@dataclass(frozen=True)
class CCast(CNode):
    """(type)of."""

    type: TypeName
    of: "Expression"


@dataclass(frozen=True)
class CBinary(CNode):
    """left operator right."""

    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True)
class CChoose(CNode):
    """condition ? first : second."""

    condition: "Expression"
    first: "Expression"
    second: "Expression"


@dataclass(frozen=True)
class CNumbers(CNode):
    """An initialiser that is nothing but decimal numbers."""

    numbers: list[int]


@dataclass(frozen=True)
class CList(CNode):
    """An initialiser of other things."""

    items: "tuple[Initialiser, ...]"


@dataclass(frozen=True)
class CBlock(CNode):
    """Statements in braces."""

    statements: "tuple[Statement, ...]"


@dataclass(frozen=True)
class CReturn(CNode):
    """Return, of a value or of nothing."""

    value: "Expression | None"


@dataclass(frozen=True)
class CIf(CNode):
    """A branch; `other` is what follows else."""

    condition: "Expression"
    then: CBlock
    other: "CBlock | CIf | None"


@dataclass(frozen=True)
class CFor(CNode):
    """for (type name = first; name operator end; name++) body."""

    type: str
    name: str
    first: "Expression"
    operator: str
    end: "Expression"
    body: CBlock


@dataclass(frozen=True)
class CWhile(CNode):
    """while (condition) body; the certificate's checker has no rule for it, and reads none."""

    condition: "Expression"
    body: CBlock


@dataclass(frozen=True)
class CDeclare(CNode):
    """A variable of a function."""

    variable: Variable


@dataclass(frozen=True)
class CAssign(CNode):
    """target operator source, such as += ."""

    operator: str
    target: "Expression"
    source: "Expression"


@dataclass(frozen=True)
class CAlone(CNode):
    """A call whose result nobody takes, or (void)of."""

    of: "Expression"


Expression: TypeAlias = (
    CInteger | CName | CField | CIndex | CCall | CUnary | CSizeof | CCast | CBinary | CChoose
)
Initialiser: TypeAlias = Expression | CNumbers | CList
Statement: TypeAlias = CBlock | CReturn | CIf | CFor | CWhile | CDeclare | CAssign | CAlone


def list_parts(node: CNode | Variable) -> Iterator[CNode]:
    """Yield the nodes that a node is made of, those of a variable that it declares too."""
    for part in vars(node).values():
        for one in part if isinstance(part, tuple) else (part,):
            if isinstance(one, CNode):
                yield one
            elif isinstance(one, Variable):
                yield from list_parts(one)


def walk(node: CNode) -> Iterator[CNode]:
    """Yield a node and all that is inside it."""
    yield node
    for part in list_parts(node):
        yield from walk(part)


def are_alike(one: CNode, other: CNode) -> bool:
    """Return whether two nodes are the same words, wherever they stand."""
    mine, its = ({**vars(node), "at": 0} for node in (one, other))
    parts = zip(list_parts(one), list_parts(other), strict=False)
    plain = all(
        mine[name] == its.get(name) for name in mine if not isinstance(mine[name], CNode | tuple)
    )
    counts = len(list(list_parts(one))) == len(list(list_parts(other)))
    return type(one) is type(other) and plain and counts and all(are_alike(*two) for two in parts)


def is_name(node: CNode | None, name: str) -> bool:
    """Return whether a node is nothing but this name."""
    return isinstance(node, CName) and node.name == name


@dataclass(frozen=True)
class Function:
    """A function with a body."""

    name: str
    result: str
    parameters: tuple[Variable, ...]
    body: CBlock


@dataclass
class Program:
    """What header and source declare, in their order."""

    tokens: PlacedWords
    structs: dict[str, tuple[Variable, ...]] = field(default_factory=dict)
    constants: list[Variable] = field(default_factory=list)
    functions: dict[str, Function] = field(default_factory=dict)
    claims: list[Expression] = field(default_factory=list)
    claim_names: list[str] = field(default_factory=list)
    assembly: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Function -> its lines of assembly."""
    declared: dict[str, int] = field(default_factory=dict)
    """Function -> the token of its first declaration."""
    signatures: dict[str, str] = field(default_factory=dict)
    """Function -> the words of its result and of its parameters, up to the last bracket."""
    static: set[str] = field(default_factory=set)
    """Functions that are."""
    naked: set[str] = field(default_factory=set)
    """Functions that are declared to have nothing around their assembly."""

    def place(self, at: int) -> str:
        """Return file:line of a token."""
        return self.tokens.places[min(at, len(self.tokens.places) - 1)]


BINARY = {"||": 1, "&&": 2, "|": 3, "^": 4, "&": 5, "==": 6, "!=": 6}
BINARY |= {"<": 7, ">": 7, "<=": 7, ">=": 7, "<<": 8, ">>": 8, "+": 9, "-": 9}
BINARY |= {"*": 10, "/": 10, "%": 10}
FUNCTIONS = ("ZD_OBSERVE", "ZD_QUIET", "ZD_CLAIM")
ASSIGNMENTS = ("=", "+=", "-=", "*=", "|=", "&=", "^=", "<<=", ">>=")
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
            if self.look() in ("[", "->", ".", *ASSIGNMENTS):
                raise self.error("a place in brackets")
            return node
        if self.look()[:1].isdigit() or self.look()[:1] == ".":
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
