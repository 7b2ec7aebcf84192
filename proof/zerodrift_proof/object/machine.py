"""A Cortex-M over terms: each instruction of an object file, with what it does to words.

Registers hold terms modulo 2^32 or curves, flags are worked out where they are asked for. Whatever
has no rule, and every branch that hangs on a number that is not known, ends the run undecided.
"""

from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.object.code import decode
from zerodrift_proof.object.curves import TABLE, WIDE, Curves, Word, WordCurve
from zerodrift_proof.object.flags import Flag, Flags, set_flags, unknown
from zerodrift_proof.object.image import Image
from zerodrift_proof.object.instruction import LR, PC, SP, Instruction
from zerodrift_proof.object.memory import LOWEST, ObjectMemory
from zerodrift_proof.object.parts import Parts
from zerodrift_proof.object.words import WORD, Words, WordTerms

MOST = 4_000_000
"""Instructions of a call."""
LINE = 11
"""A line of the table of tanh is 2^11 wide."""
ACCESS = {"ldr": (4, False), "ldrh": (2, False), "ldrsh": (2, True),
          "str": (4, False), "strh": (2, False)}  # fmt: skip
"""Name -> bytes, and whether they are extended with their sign."""


class ObjectMachine:
    """Runs a function of a program."""

    def __init__(self, image: Image) -> None:
        """Begin with registers of any value and no memory but the program's constants."""
        self.image, self.terms = image, WordTerms()
        self.words = Words(self.terms)
        self.curves, self.memory = Curves(self.words), ObjectMemory(self.words, image)
        self.parts = Parts(self.words, self.curves)
        self.registers: list[Word] = [
            self.terms.symbol(f"r{k} before", 0, WORD - 1) for k in range(15)
        ]
        self.flags = Flags()
        self.at = 0
        """Of the instruction that is run."""
        self.floor = 0
        """The stack pointer, in bytes from where it was at the call."""
        self.count = 0
        self._it: int | None = None
        self._decoded: dict[tuple[int, bool], Instruction] = {}

    # --- a call

    def call(self, entry: int) -> None:
        """Run a function until it returns; registers and areas are set.

        Raises:
            UndecidedError: something has no rule, or the function breaks the rules of a call.
        """
        before = list(self.registers)
        self.at, self.count, self.floor, self._it = entry, 0, 0, None
        while self.at >= 0:
            self.count += 1
            if self.count > MOST:
                raise UndecidedError(f"no return within {MOST} instructions")
            self.step()
        for k in (*range(4, 12), SP):
            if self.registers[k] is not before[k]:
                raise UndecidedError(f"r{k} is not given back")

    def step(self) -> None:
        """Run one instruction."""
        given, self._it = self._it, None
        one = self._fetch(given is not None)
        after = self.at + one.size
        if given is None or one.name == "it":
            self.at = self._run(one, after)
            return
        truth = self._holds(given)
        if isinstance(truth, Whole) and truth.exact is not None:
            self.at = self._run(one, after) if truth.exact else after
            return
        if one.name != "mov" or one.sets:
            raise UndecidedError("what is done hangs on a number that is not known")
        old, new = self.registers[one.d], self._operand(one)[0]
        self.registers[one.d] = self.curves.apply(("choose",), self.words.choose, truth, new, old)
        self.at = after

    def _fetch(self, in_it: bool) -> Instruction:
        key = self.at, in_it
        if key not in self._decoded:
            first = self.image.fetch(self.at)
            if first is None:
                raise UndecidedError("no instruction of this program")
            second = self.image.fetch(self.at + 2) or b"\0\0"
            halves = [int.from_bytes(half, "little") for half in (first, second)]
            self._decoded[key] = decode(halves[0], halves[1], in_it)
        return self._decoded[key]

    def _run(self, one: Instruction, after: int) -> int:
        """Return where to go on; below 0 after a return."""
        name = one.name
        if name in ("b", "bl", "cbz", "cbnz"):
            return self._branch(one, after)
        if name == "bx":
            return self._go(self._read(one.m))
        if name == "it":
            self._it = one.condition
        elif name in ACCESS:
            self._access(one)
        elif name in ("ldrd", "strd"):
            self._access_two(one)
        elif name in ("ldm", "stm", "push"):
            return self._access_many(one, after)
        elif name != "nop":
            self._compute(one)
        return after

    # --- registers, branches

    def _read(self, k: int) -> Word:
        return self.words.number(self.at + 4) if k == PC else self.registers[k]

    def _whole(self, k: int) -> Whole:
        return self.curves.settle(self._read(k))

    def _settle(self, k: int) -> Whole:
        """Return a register as a term, and hold it as that from now on."""
        word = self._read(k)
        return self._settle_word(word) if isinstance(word, WordCurve) else word

    def _write(self, k: int, value: Word) -> None:
        if k == SP:
            area, at = self.memory._find(self.curves.settle(value))
            if area is None or area.name != "stack" or at % 4 or not LOWEST <= at <= 0:
                raise UndecidedError("a stack pointer that is not known")
            self.floor = at
            self.memory.release(at)
        self.registers[k] = value

    def _branch(self, one: Instruction, after: int) -> int:
        target = self.at + 4 + one.value
        if one.name == "bl":
            self.registers[LR] = self.words.number(after | 1)
            return target
        if one.name == "b":
            truth = self._holds(one.condition)
        else:
            zero = self.curves.apply(("zero",), self.words.is_zero, self._read(one.n))
            truth = zero
        if not isinstance(truth, Whole) or truth.exact is None:
            raise UndecidedError("a branch that hangs on a number that is not known")
        return target if truth.exact == (one.name != "cbnz") else after

    def _go(self, where: Word) -> int:
        if where is self.terms.symbol(f"r{LR} before", 0, WORD - 1):
            return -1
        if isinstance(where, WordCurve) or where.exact is None or not where.exact & 1:
            raise UndecidedError("a branch to where is not known")
        return where.exact % WORD & ~1

    def _holds(self, condition: int) -> Word:
        """Return whether a condition holds."""
        return self.flags.hold(condition, self.curves)

    # --- loads and stores

    def _address(self, one: Instruction) -> tuple[Word, Word]:
        """Return the address of an access, and what is written back."""
        base: Word = self._read(one.n)
        if one.n == PC:
            base = self.words.number(self.at + 4 & ~3)
        if one.m >= 0:
            moved = self._shift(self._read(one.m), "lsl", one.by)
        else:
            moved = self.words.number(one.value)
        after = self.curves.apply(("add",), self.words.add, base, moved)
        return (after if one.before else base), after

    def _load(self, address: Word, size: int, signed: bool, loose: bool) -> Word:
        if isinstance(address, Whole) and address.exact is None:
            address = self._lift_place(address)
        if not isinstance(address, WordCurve):
            return self.memory.load(address, size, signed, self.floor, loose)

        def look_up(at: Whole) -> Whole:
            if at.exact is None:
                raise UndecidedError("a place in a table that is not known")
            return self.memory.load(at, size, signed, 0, loose)

        return self.curves.apply(("load", size, signed), look_up, address)

    def _lift_place(self, address: Whole) -> Word:
        """Return a place in a table, constant + f (t >> 11), as a curve of a t in a register."""
        for t in self.registers:
            if isinstance(t, WordCurve) or t.exact is not None:
                continue
            line = self.terms.shift(t, LINE)
            for size in (1, 2, 4):
                start = self.terms.subtract(address, self.terms.scale(line, size))
                if start.exact is not None:
                    return self._find_place(self.curves.begin(TABLE, t), size, start)
        return address

    def _find_place(self, t: WordCurve, size: int, start: Whole) -> Word:
        words, apply = self.words, self.curves.apply
        line = apply(("line",), lambda a: self.terms.shift(a, LINE), t)
        at = apply(("x", size), lambda a: self.terms.scale(a, size), line)
        return apply(("add",), words.add, at, start)

    def _access(self, one: Instruction) -> None:
        address, after = self._address(one)
        size, signed = ACCESS[one.name]
        if one.name.startswith("ldr"):
            value = self._load(address, size, signed, True)
            if one.back:
                self._write(one.n, after)
            self._write(one.d, value)
            return
        place, value = self.curves.settle(address), self._settle(one.d)
        if one.back:
            self._write(one.n, after)
        self.memory.store(place, size, value, self.floor)

    def _access_two(self, one: Instruction) -> None:
        address, after = self._address(one)
        place = self.curves.settle(address)
        places = place, self.terms.add(place, self.words.number(4))
        if one.name == "ldrd":
            values = [self._load(p, 4, False, False) for p in places]
        else:
            values = [self._whole(one.d), self._whole(one.a)]
            for p, value in zip(places, values, strict=True):
                self.memory.store(p, 4, self.curves.settle(value), self.floor)
        if one.back:
            self._write(one.n, after)
        if one.name == "ldrd":
            self.registers[one.d], self.registers[one.a] = values

    def _access_many(self, one: Instruction, after: int) -> int:
        base, count = self._whole(one.n), len(one.registers)
        if one.name == "push":
            base = self.terms.subtract(base, self.words.number(4 * count))
            self._write(one.n, base)
        places = [self.terms.add(base, self.words.number(4 * k)) for k in range(count)]
        if one.name != "ldm":
            for k, place in zip(one.registers, places, strict=True):
                self.memory.store(place, 4, self._settle(k), self.floor)
        else:
            values = [self._load(place, 4, False, False) for place in places]
            for k, value in zip(one.registers, values, strict=True):
                if k != PC:
                    self.registers[k] = value
        if one.back and one.name != "push":
            self._write(one.n, self.terms.add(base, self.words.number(4 * count)))
        if one.name == "ldm" and one.registers[-1] == PC:
            return self._go(values[-1])
        return after

    # --- numbers

    def _shift(self, word: Word, kind: str, by: int) -> Word:
        if by == 0:
            return word
        if kind == "asr" and by >= 31:
            word = self._find_sign(word, by)
        elif kind == "lsl" and isinstance(word, WordCurve) and self.curves.overflows(word, by):
            word = self._settle_word(word)
        return self.parts.shift(word, kind, by)

    def _settle_word(self, word: WordCurve) -> Whole:
        """Return a curve as a term; a register that holds it holds the term from now on."""
        whole = self.curves.settle(word)
        self.registers = [whole if r is word else r for r in self.registers]
        return whole

    def _find_sign(self, word: Word, by: int) -> Word:
        """Return a word as a curve of which each piece has one sign, as far as there is one."""
        if isinstance(word, WordCurve):
            signs = self.parts.shift(word, "asr", by)
            if isinstance(signs, Whole) or all(v.exact is not None for v in signs.values):
                return word
            word = self._settle_word(word)
        return word if word.exact is not None else self._lift(word)

    def _lift(self, word: Whole) -> Word:
        """Return a word of which a mask of its sign is made, as a curve."""
        if word.low < -(WORD >> 1) or word.high >= WORD >> 1:
            return self.curves.begin(WIDE, word)
        floor = self.words.floor_word
        for other in self.registers:
            if not isinstance(other, Whole) or other.high - other.low < WORD:
                continue
            if floor(other) is word:  # the upper word of a number of 64 bits
                return self.curves.apply(("floor",), floor, self.curves.begin(WIDE, other))
        return self.curves.begin(TABLE, word)

    def _operand(self, one: Instruction) -> tuple[Word, Flag]:
        """Return the last operand, and the carry that making it leaves."""
        if one.m < 0:
            old = self.flags.c
            value = self.words.number(one.value)
            if one.carry is None:
                return value, old
            bit = self.words.number(one.carry)
            return value, lambda: bit
        word, kind, by = self._read(one.m), one.shift, one.by
        if by == 0:
            return word, self.flags.c
        shifted = self._shift(word, kind, by)
        if kind == "asr" and by >= 31 and isinstance(word, Whole) and word.exact is None:
            word = self._lift(word)
        words = self.words
        return shifted, lambda: self.curves.apply(
            ("out", kind, by), lambda a: words.shifted_out(a, kind, by), word
        )

    def _compute(self, one: Instruction) -> None:
        name = one.name
        if name in ("add", "adc", "sub", "sbc", "rsb", "cmp", "cmn"):
            self._add(one)
        elif name in ("and", "bic", "orr", "eor", "mov", "mvn", "tst", "teq"):
            self._on_bits(one)
        elif name == "shift":
            self._shift_by_register(one)
        elif name in ("ssat", "usat"):
            self._limit(one)
        else:
            self._others(one)

    def _add(self, one: Instruction) -> None:
        """Sums; a difference adds what has every bit inverted, and 1 or the carry."""
        name, (b, _) = one.name, self._operand(one)
        a, words, apply = self._read(one.n), self.words, self.curves.apply
        if name == "rsb":
            a, b = b, a
        if name in ("sub", "cmp", "rsb", "sbc"):
            b = apply(("invert",), words.invert, b)
        more: Word = words.number(int(name in ("sub", "cmp", "rsb")))
        if name in ("adc", "sbc"):
            more = self.flags.c()
        total = apply(("sum",), lambda x, y, z: words.add(words.add(x, y), z), a, b, more)
        if one.sets:
            terms = self.terms

            def overflows(x: Whole, y: Whole, z: Whole) -> Whole:
                exact = terms.add(terms.add(words.signed(x), words.signed(y)), z)
                return terms.negate(terms.equal(words.signed(exact), exact))

            self.flags = set_flags(
                self.curves,
                total,
                lambda: apply(("carry",), words.carry, a, b, more),
                lambda: apply(("overflow",), overflows, a, b, more),
            )
        if one.d >= 0:
            self._write(one.d, total)

    def _on_bits(self, one: Instruction) -> None:
        name, (b, carry) = one.name, self._operand(one)
        words, apply = self.words, self.curves.apply
        if name in ("bic", "mvn"):
            b = apply(("invert",), words.invert, b)
        if name in ("mov", "mvn"):
            total = b
        else:
            kind = {"bic": "and", "tst": "and", "teq": "eor"}.get(name, name)
            ways = {"and": words.both, "orr": words.either, "eor": words.differ}
            total = apply((kind,), ways[kind], self._read(one.n), b)
        if one.sets:
            self.flags = set_flags(self.curves, total, carry, self.flags.v)
        if one.d >= 0:
            self._write(one.d, total)

    def _shift_by_register(self, one: Instruction) -> None:
        words, by = self.words, self._whole(one.m)
        amount = words.residue(by, 8, False).exact
        if amount is None and one.shift == "lsl":
            total: Word = words.shift_left_by(self._whole(one.n), by)
            if one.sets:
                self.flags = set_flags(self.curves, total, unknown, self.flags.v)
        elif amount is None or (one.sets and not 0 < amount < 32) or amount > 31:
            raise UndecidedError("a shift by what is not known")
        else:
            word = self._read(one.n)
            total = self._shift(word, one.shift, amount)
            if one.sets:
                kind, apply = one.shift, self.curves.apply
                self.flags = set_flags(
                    self.curves,
                    total,
                    lambda: apply(
                        ("out", kind, amount), lambda a: words.shifted_out(a, kind, amount), word
                    ),
                    self.flags.v,
                )
        self._write(one.d, total)

    def _limit(self, one: Instruction) -> None:
        word = self._read(one.m)
        if one.name == "ssat" and one.value == 20:
            word = self.curves.settle(word)
        elif (one.name, one.value, one.shift, one.by) == ("ssat", 9, "asr", 11):
            word = self.parts.begin_lines(word)
        word = self._shift(word, one.shift, one.by)
        self._write(one.d, self.parts.limit(word, one.value, one.name == "ssat"))

    def _others(self, one: Instruction) -> None:
        name, words, apply = one.name, self.words, self.curves.apply
        if name == "smull":
            product = apply(("x",), words.multiply_signed, self._read(one.n), self._read(one.m))
            self._write(one.d, product)
            self._write(one.a, apply(("floor",), words.floor_word, product))
            return
        zero = words.number(0)
        n, m, a = (self._read(k) if k >= 0 else zero for k in (one.n, one.m, one.a))
        self._write(one.d, self.parts.make(one, n, m, a))
        if one.sets:  # MULS leaves carry and overflow as they are
            self.flags = set_flags(self.curves, self.registers[one.d], self.flags.c, self.flags.v)
