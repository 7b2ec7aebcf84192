"""The expressions of a generated model's C, with intervals in place of numbers.

Shares no code with the generator and needs the standard library only.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from zerodrift.verify.c_reader import TYPES, Array, Code, NotUnderstoodError, Value

PRECEDENCE = {"||": 1, "&&": 2, "|": 3, "&": 4, "==": 5, "!=": 5, "<": 6, ">": 6, "<=": 6, ">=": 6}
PRECEDENCE |= {"+": 8, "-": 8, "*": 9}
RANKS = ["int32_t", "uint32_t", "int64_t", "uint64_t"]


class Expressions:
    """Evaluates expressions from a place in the C on, and notes what they reach."""

    def __init__(self, code: Code, rules: Mapping[str, Callable[..., Any]]) -> None:
        """Stand before the first token.

        Args:
            code: what the model's files declare.
            rules: what the runtime's functions do with intervals, by name.
        """
        self.code, self._rules = code, rules
        self.bounds: dict[str, tuple[int, int, int]] = {}
        """Name -> lowest, highest, bits that hold them."""
        self.shifts: dict[str, int] = {}
        self.recurrent: set[tuple[str, tuple[Value, ...]]] = set()
        """The recurrent layers that were stepped, and under which features."""
        self.failures: list[str] = []
        self._at = 0
        self._locals: dict[str, Any] = {}
        self._narrow: dict[str, Value] = {}  # field -> what it can be in this branch
        self._compared: tuple[str, str, int] | None = None
        self.pending: dict[str, tuple[int, int, int]] = {}
        """Bounds of the node that is being computed, by their last name."""
        self.shift: int | None = None
        """The shift of the node that is being computed."""
        self.row_of = ""
        """The node whose weights were multiplied last."""
        self._returned: Any = None
        self._stored: set[str] = set()
        self._called: set[str] = set()
        self._fields: dict[str, Any] = {}
        self._unfilled: set[str] = set()
        """Structs of inputs of this function's own that hold nothing yet."""

    def note(self, where: str, low: int, high: int, bits: int) -> None:
        """Note a bound that the C relies on; more than one visit widens it."""
        before = self.bounds.get(where, (low, high, bits))
        self.bounds[where] = (min(low, before[0]), max(high, before[1]), bits)
        if low < -(1 << (bits - 1)) or high >= 1 << (bits - 1):
            self.failures.append(f"{where}: reaches {low} .. {high}; it does not fit {bits} bits")

    def fail(self, what: str) -> None:
        """Note what is wrong where the machine stands."""
        self.failures.append(
            f"{self.code.places[min(self._at, len(self.code.places) - 1)]}: {what}"
        )

    @property
    def _token(self) -> str:
        return self.code.tokens[self._at]

    def _take(self, expected: str = "") -> str:
        token = self._token
        if expected and token != expected:
            place = self.code.places[self._at]
            raise NotUnderstoodError(f"{place}: '{token}' where '{expected}' was expected")
        self._at += 1
        return token

    def convert(self, value: Value, kind: str) -> Value:
        """Return a value in a C type, which must hold it and every partial sum behind it."""
        low, high = TYPES[kind]
        if value.low < low or value.high > high:
            self.fail(f"{value.low} .. {value.high} does not fit {kind}")
            return Value(low, high, kind)
        return Value(value.low, value.high, kind, value.reach)

    def _expression(self, floor: int = 0) -> Any:
        left = self._unary()
        while PRECEDENCE.get(self._token, 0) > floor:
            operator = self._take()
            left = self.combine(operator, left, self._expression(PRECEDENCE[operator]))
        if floor == 0 and self._token == "?":
            compared = self._compared
            self._take()
            first = self._expression()
            self._take(":")
            if compared and compared[1] == "==" and compared[2] == self._fields[compared[0]].high:
                self._assume(compared[0], below=compared[2])
            left = first.join(self._expression())
            self._narrow.clear()
        return left

    def _assume(self, name: str, below: int) -> None:
        """Know a field to be less than `below` until this branch ends."""
        known = self._fields[name]
        self._narrow[name] = replace(known, high=min(known.high, below - 1), reach=0)

    def combine(self, operator: str, a: Value, b: Value) -> Value:
        """Return a operator b in the type that C gives it, which must hold the result."""
        kind = max((v.type if v.type in RANKS else "int32_t" for v in (a, b)), key=RANKS.index)
        self._compared = None
        if operator in ("+", "-"):
            b = b if operator == "+" else Value(-b.high, -b.low, b.type, b.reach)
            result = Value(a.low + b.low, a.high + b.high, kind, a.reach + b.reach)
        elif operator == "*":
            if "code" in self.pending:
                self.pending["code"] = (a.low, a.high, 32)
            ends = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
            result = Value(min(ends), max(ends), kind, a.reach * b.reach)
        elif operator in ("|", "&"):
            return Value(0, TYPES["uint32_t"][1], "uint32_t")
        else:
            self._compared = (a.place, operator, b.low) if a.place and b.low == b.high else None
            if operator == "<" and (a.high < b.low or a.low >= b.high):
                answer = int(a.high < b.low)
                return Value(answer, answer)
            return Value(0, 1)
        return self.convert(result, kind)

    def _unary(self) -> Any:
        token = self._take()
        if token == "(":
            if self._token in TYPES and self.code.tokens[self._at + 1] == ")":
                kind = self._take()
                self._take(")")
                value = self._unary()
                if kind == "int32_t" and value.type == "int64_t":
                    self.note_plain_sum(value)
                return self.convert(value, kind)
            value = self._expression()
            self._take(")")
            return value
        if token == "-":
            value = self._unary()
            return Value(-value.high, -value.low, value.type, value.reach)
        if token == "&":
            name = self._token
            if self.code.tokens[self._at + 1] == "[":  # the rest of an array from an element on
                self._take()
                array = self._locals[name] if name in self._locals else self.code.constants[name]
                first = self._take_size()
                try:
                    return array.rest(first)
                except IndexError as error:
                    self.fail(str(error))
                    return array
            return self._unary()
        if token[0].isdigit():
            number = int(token.rstrip("u"))
            kind = "uint32_t" if token.endswith("u") else "int32_t"
            return Value(number, number, kind if number <= TYPES[kind][1] else "int64_t")
        if self._token == "(":
            return self._call(token)
        return self._read(token)

    def note_plain_sum(self, value: Value) -> None:
        """A node's 64-bit value that went through no shift is a sum."""
        if self.shift is None and not self.pending:
            self.pending["sum"] = (-value.reach, value.reach, 64)

    def _read(self, token: str) -> Any:
        """Return the variable, constant or field whose name was taken, after its indices."""
        if token in self._unfilled:
            raise NotUnderstoodError(f"{self.code.places[self._at - 1]}: '{token}' holds nothing")
        if self._token in ("->", "."):
            self._take()
            name = self._take()
            value = self._narrow.get(name, self._fields[name])
        elif token in self._locals:
            value = self._locals[token]
        elif token in self.code.macros:
            return Value(self.code.macros[token], self.code.macros[token])
        elif token in self.code.constants:
            value = self.code.constants[token]
        else:
            raise NotUnderstoodError(f"{self.code.places[self._at - 1]}: '{token}' is not known")
        while self._token == "[":
            value = self._index(value)
        return value

    def _index(self, array: Array) -> Any:
        self._take("[")
        index = self._expression()
        self._take("]")
        try:
            cells = [array.cells[i] for i in array.at(index)]
        except IndexError as error:
            self.fail(str(error))
            return array.cells[0]
        value = cells[0]
        for cell in cells[1:]:
            value = value.join(cell)
        return value

    def _take_size(self) -> int:
        self._take("[")
        size = self._expression()
        self._take("]")
        return int(size.low)

    def _call(self, name: str) -> Any:
        self._take("(")
        arguments = []
        if name == f"{self.code.prefix}_hold":
            self._unfilled.clear()
        while self._token != ")":
            arguments.append(self._expression())
            if self._token == ",":
                self._take()
        self._take(")")
        if name == "INT64_C":
            return replace(arguments[0], type="int64_t")
        self._called.add(name)
        if name in self._rules:
            return self._rules[name](self, *arguments)
        if name == f"{self.code.prefix}_state_is_sound":
            return Value(0, 1)
        if name == f"{self.code.prefix}_init":
            return None
        if name in self.code.functions:
            return self._call_function(name, arguments)
        raise NotUnderstoodError(f"{self.code.places[self._at - 1]}: there is no rule for {name}")

    def _call_function(self, name: str, arguments: list[Any]) -> Any:
        """Run a function of the model."""
        raise NotImplementedError
