"""C's types and operators on intervals, and a list of what they reach.

C's own rules give every operation its type, which must hold the result. Shares no code with the
generator and needs the standard library only.
"""

from zerodrift_proof.certificate.nodes import CInteger, Program
from zerodrift_proof.certificate.values import (
    BITS,
    TYPES,
    FaultError,
    NotUnderstoodError,
    Value,
    is_signed,
)

MOST_WORK = 2_000_000
"""Expressions and statements that are looked at before a model is taken to have no end."""
MIRRORED = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "==", "!=": "!="}


class Arithmetic:
    """Calculates with intervals as C does, and notes what they reach."""

    def __init__(self, program: Program, int_bits: int) -> None:
        """Prepare for a program.

        Args:
            program: what the model's files declare.
            int_bits: of C's int, 16 or 32.
        """
        self.program = program
        self.int, self.unsigned = f"int{int_bits}_t", f"uint{int_bits}_t"
        self.packed = int_bits == 16
        """Whether structs are laid out without gaps."""
        self.bounds: dict[str, tuple[int, int, int]] = {}
        """Name -> lowest, highest, bits that hold them."""
        self.shifts: dict[str, int] = {}
        self.failures: list[str] = []
        self.pending: dict[str, tuple[int, int, int]] = {}
        """Bounds of the node that is being computed, by their last name."""
        self.shift: int | None = None
        """The shift of the node that is being computed."""
        self.row_of = ""
        """The node whose weights were multiplied last."""
        self._at, self._work = 0, 0

    # --- what is found

    def note(self, where: str, low: int, high: int, bits: int) -> None:
        """Note a bound that the C relies on; more than one visit widens it."""
        before = self.bounds.get(where, (low, high, bits))
        self.bounds[where] = (min(low, before[0]), max(high, before[1]), max(bits, before[2]))
        if low < -(1 << (bits - 1)) or high >= 1 << (bits - 1):
            self.fail(f"{where}: reaches {low} .. {high}; it does not fit {bits} bits")

    def note_shift(self, where: str, amount: int) -> None:
        """Note by how much something is shifted; it cannot be two amounts."""
        if self.shifts.setdefault(where, amount) != amount:
            self.fail(f"{where}: {amount} here, {self.shifts[where]} elsewhere")

    def fail(self, what: str) -> None:
        """Note what is wrong where the machine stands."""
        text = f"{self.program.place(self._at)}: {what}"
        if text not in self.failures:
            self.failures.append(text)

    def stand_at(self, at: int) -> None:
        """Remember where in the C this is; stop where there is no end to it."""
        self._at, self._work = at, self._work + 1
        if self._work > MOST_WORK:
            raise NotUnderstoodError(f"{self.program.place(at)}: no end after {MOST_WORK} steps")

    def not_understood(self, what: str) -> NotUnderstoodError:
        """Return what to raise where there is no rule."""
        return NotUnderstoodError(f"{self.program.place(self._at)}: {what}")

    # --- types

    def convert(self, value: Value, kind: str) -> Value:
        """Return a value in a C type: a signed one must hold it, an unsigned one wraps."""
        low, high = TYPES[kind]
        if low <= value.low and value.high <= high:
            if value.type == kind:
                return value
            return Value(value.low, value.high, kind, value.reach, value.copy_of)
        if is_signed(kind):
            self.fail(f"{value.low} .. {value.high} does not fit {kind}")
            return Value(low, high, kind)
        if value.exact is not None:
            wrapped = value.low % (high + 1)
            return Value(wrapped, wrapped, kind)
        return Value(low, high, kind)

    def keep(self, value: Value, kind: str) -> Value:
        """Return a value in a C type that must hold it: what stands there without a cast."""
        low, high = TYPES[kind]
        if value.low < low or value.high > high:
            self.fail(f"{value.low} .. {value.high} does not fit {kind}")
        return self.convert(value, kind)

    def promote(self, kind: str) -> str:
        """Return the type in which C calculates with one."""
        if BITS[kind] > BITS[self.int]:
            return kind
        return self.unsigned if kind == self.unsigned else self.int

    def common(self, a: str, b: str) -> str:
        """Return the type in which C calculates with two."""
        a, b = self.promote(a), self.promote(b)
        if BITS[a] != BITS[b]:
            return a if BITS[a] > BITS[b] else b
        return b if is_signed(a) else a

    def type_literal(self, node: CInteger) -> Value:
        """Return a literal in the first type of its list that holds it (C99 6.4.4.1)."""
        number, unsigned, longs = node.number, node.unsigned, node.longs
        kinds = [self.int, self.unsigned, "int32_t", "uint32_t", "int64_t", "uint64_t"]
        if longs:  # long has 32 bits or 64; a literal must not rest on which
            kinds = kinds[2:] if longs == 1 else kinds[4:]
        decimal = node.token[0] != "0" or number == 0
        for kind in kinds:
            if unsigned and is_signed(kind):
                continue
            if not unsigned and decimal and not is_signed(kind):
                continue
            if number <= TYPES[kind][1]:
                return Value(number, number, kind)
        raise self.not_understood(f"{node.token} has no type")

    # --- operators

    def combine(self, operator: str, a: Value, b: Value) -> Value:
        """Return a operator b in the type that C gives it, which must hold the result."""
        if operator in ("<<", ">>"):
            return self._shift(operator, a, b)
        kind = self.common(a.type, b.type)
        a, b = self.convert(a, kind), self.convert(b, kind)
        if operator in MIRRORED:
            return self._compare(operator, a, b)
        if operator in ("&", "|", "^"):
            return self._on_bits(operator, a, b, kind)
        if operator in ("/", "%"):
            if a.exact is None or b.exact is None or b.exact <= 0 or a.exact < 0:
                raise self.not_understood("a division")
            number = a.exact // b.exact if operator == "/" else a.exact % b.exact
            return Value(number, number, kind)
        if operator == "*":
            if "code" in self.pending:
                self.pending["code"] = (a.low, a.high, 32)
            ends = [x * y for x in (a.low, a.high) for y in (b.low, b.high)]
            low, high, reach = min(ends), max(ends), a.reach * b.reach
        elif operator == "+":
            low, high, reach = a.low + b.low, a.high + b.high, a.reach + b.reach
        else:
            low, high, reach = a.low - b.high, a.high - b.low, a.reach + b.reach
        return self.convert(Value(low, high, kind, reach), kind)

    def _compare(self, operator: str, a: Value, b: Value) -> Value:
        if operator in (">", ">="):
            operator, a, b = MIRRORED[operator], b, a
        if operator == "<":
            return self._truth(a.high < b.low, a.low >= b.high)
        if operator == "<=":
            return self._truth(a.high <= b.low, a.low > b.high)
        same = a.exact is not None and a.exact == b.exact
        apart = a.high < b.low or b.high < a.low
        return self._truth(same, apart) if operator == "==" else self._truth(apart, same)

    def _on_bits(self, operator: str, a: Value, b: Value, kind: str) -> Value:
        if min(a.low, b.low) < 0:
            raise self.not_understood(f"{operator} of a negative number")
        if a.exact is not None and b.exact is not None:
            both = {"&": a.exact & b.exact, "|": a.exact | b.exact, "^": a.exact ^ b.exact}
            return Value(both[operator], both[operator], kind)
        if operator == "&":
            return Value(0, min(a.high, b.high), kind)
        top = (1 << max(a.high, b.high).bit_length()) - 1
        return Value(max(a.low, b.low) if operator == "|" else 0, top, kind)

    def _shift(self, operator: str, a: Value, b: Value) -> Value:
        kind = self.promote(a.type)
        a = self.convert(a, kind)
        if b.exact is None or not 0 <= b.exact < BITS[kind]:
            raise FaultError(f"a shift of {BITS[kind]} bits by {b.low} .. {b.high}")
        if a.low < 0:
            raise self.not_understood("a shift of a negative number")
        if operator == "<<":
            return self.convert(Value(a.low << b.exact, a.high << b.exact, kind), kind)
        return Value(a.low >> b.exact, a.high >> b.exact, kind)

    def _truth(self, true: bool, false: bool) -> Value:
        return Value(int(true), int(not false), self.int)
