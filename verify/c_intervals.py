"""Runs the C of a generated model over intervals in place of numbers.

Every operation must fit its C type, every index its array. What the state may hold at the start of
a step is what the C itself tests (`..._state_is_sound`); that each step leaves it so closes the
induction. Shares no code with the generator and needs the standard library only.
"""

import copy
import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from zerodrift.verify.c_expressions import Expressions
from zerodrift.verify.c_reader import TYPES, Array, Code, NotUnderstoodError, Value, make_array

SOUND_FORMS = (
    r"uint32_t sound = \( s -> identity == PREFIX_MODEL_ID \) \? 1u : 0u ;",
    r"if \( s -> steps == 0u \) \{ return sound ; \}",
    r"if \( (\( )?s -> \w+ (\[ \w+ \] )?(<|>|>=) -?\d+u? \)"
    r"( \|\| \( s -> \w+ (\[ \w+ \] )?> -?\d+ \) \))? \{ sound = 0u ; \}",
    r"for \( uint32_t k = 0 ; k < \d+u ; k \+\+ \) \{ *\}",
    r"sound &= zd_gru_state_is_sound \( s -> \w+ , \d+u \) ;",
    r"return sound ;",
)
"""What a state check is made of; nothing else may stand in one."""


class Machine(Expressions):
    """Runs the functions of a model over intervals and notes what they reach."""

    def __init__(self, code: Code, rules: Mapping[str, Callable[..., Any]]) -> None:
        """Run `step` and `settle` of the model.

        Args:
            code: what its files declare.
            rules: what the runtime's functions do with intervals, by name.

        Raises:
            NotUnderstoodError: the C holds something without a rule.
        """
        super().__init__(code, rules)
        self.h_limit = code.macros["ZD_GRU_H_LIMIT_Q30"]
        self._fields = self._read_state()
        self._prove_recurrence()
        for name, needs in (("step", ("state_is_sound", "rest")), ("settle", ("init", "rest"))):
            self._called.clear()
            self._call_function(f"{code.prefix}_{name}", [])
            for needed in needs:
                if f"{code.prefix}_{needed}" not in self._called:
                    self.failures.append(f"{code.prefix}_{name} does not call {needed}")

    def _read_state(self) -> dict[str, Any]:
        prefix, fields = self.code.prefix, {}
        begin = self.code.functions[f"{prefix}_state_is_sound"][1]
        test = " ".join(self.code.tokens[begin : self.code.close[begin]])
        test = re.sub(r"INT64_C \( (.*?) \)", r"\1", test.replace("- ", "-"))
        for lowest in (-(2**31), -(2**63)):  # has no literal in C
            test = test.replace(f"( {lowest + 1} -1 )", str(lowest))
        left = test
        for form in SOUND_FORMS:
            left = re.sub(form.replace("PREFIX", prefix.upper()), "", left)
        if left.strip("{} "):
            raise NotUnderstoodError(f"{prefix}_state_is_sound: {left.strip('{} ')}")
        for struct, members in self.code.structs.items():
            for name, (kind, sizes) in members.items():
                low, high = TYPES[kind]
                cell = rf"s -> {name} (?:\[ k \] )?"
                own = re.findall(
                    rf"\( s -> {name} \[ (\d+) \] < (-?\d+) \)"
                    rf" \|\| \( s -> {name} \[ (\d+) \] > (-?\d+) \)",
                    test,
                )
                if struct == f"{prefix}_state_t" and own:  # each element has its own range
                    places = [(int(i), int(j)) for i, _, j, _ in own]
                    if places != [(i, i) for i in range(*sizes)]:
                        raise NotUnderstoodError(f"{prefix}_state_is_sound: {name} {places}")
                    cells = [Value(int(low), int(high), kind) for _, low, _, high in own]
                    fields[name] = Array(cells, len(cells), place=name)
                    continue
                if struct == f"{prefix}_state_t":
                    _require_all(name, sizes, test)
                    stem, _, last = name.rpartition("_")
                    if m := re.search(rf"\( {cell}< (-?\d+) \) \|\| \( {cell}> (-?\d+) \)", test):
                        low, high = int(m[1]), int(m[2])
                        self.note(f"{stem}.{last}", low, high, 64 if kind == "int64_t" else 32)
                    if m := re.search(rf"{cell}(>=?) (\d+)u", test):
                        high = int(m[2]) - (m[1] == ">=")
                    if f"zd_gru_state_is_sound ( s -> {name} ," in test:
                        low, high = -self.h_limit, self.h_limit
                    if last in ("line", "window"):
                        self.note(f"{stem}.{'steps' if last == 'line' else last}", 1, sizes[0], 16)
                fields[name] = make_array(kind, sizes, low, high, name)
        return fields

    def _prove_recurrence(self) -> None:
        """Show |h| <= limit by induction, from the lines that tanh is made of."""
        lines, limit = read_lines(self.code.tables), self.h_limit
        ends = [end for line in lines for end in line]
        self.lines = len(lines)
        self.tanh_max = max(map(abs, ends))
        self.r_max = (1 << 30) + self.tanh_max
        shown = {
            "tanh rises from line to line": ends == sorted(ends),
            "tanh is odd": [-e[0] for e in lines[:0:-1]] == [e[0] for e in lines[1:]],
            "u <= 1 - 2^-16: from |n - h| >= 2^16 a step does not pass n": self.r_max
            <= (1 << 31) - (1 << 15),
            "from nearer it passes n by 1 at most": self.tanh_max + 1 <= limit,
            "the state's copy fits 16 bits": (limit + (1 << 14)) >> 15 <= 32767,
        }
        self.failures += [
            f"|h| <= {limit} does not hold: {k}" for k, true in shown.items() if not true
        ]

    def _call_function(self, name: str, arguments: list[Any]) -> Any:
        """Run a function of the model; pointers to state and input need no value."""
        parameters, begin = self.code.functions[name]
        kept, place, prefix = self._locals, self._at, self.code.prefix
        outputs = self.code.macros[f"{prefix.upper()}_OUTPUTS"]
        given = arguments or [None, None, Array([Value(0, 0)] * outputs, outputs)]
        self._locals = {p[1]: a for p, a in zip(parameters, given, strict=False)}
        rest = name == f"{prefix}_rest"
        stored = self._stored
        self._stored = set() if rest or name == f"{prefix}_hold" else stored
        self._at = begin
        self._block()
        left = set(self.code.structs[f"{prefix}_state_t"]) - {"identity", "steps", "drift"}
        left -= self._stored
        if rest and left:
            self.fail(f"at rest the fields {sorted(left)} are not set")
        if name == f"{prefix}_hold":
            left = set(self.code.structs[f"{prefix}_input_t"]) - self._stored
            if left:
                self.fail(f"the inputs {sorted(left)} are not filled in")
            self._stored = stored
        self._locals, self._at = kept, place
        return self._returned

    # --- statements

    def _block(self) -> bool:
        """Run a block in braces; tell whether it returns. Its own variables end with it."""
        end = self.code.close[self._at]
        before, returned = set(self._locals), False
        self._take("{")
        while self._at < end and not returned:
            returned = self._statement()
        self._at = end + 1
        for name in [n for n in self._locals if n not in before]:
            del self._locals[name]
        return returned

    def _statement(self) -> bool:
        token = self._token
        if token == "{":
            return self._block()
        if token == "if":
            self._branch()
        elif token == "for":
            self._loop()
        elif token == "return":
            self._take()
            self._returned = None if self._token == ";" else self._expression()
            return True
        elif token == "const" or token in TYPES:
            self._declare()
        elif token == f"{self.code.prefix}_input_t":
            self._take()
            name = self._take()
            self._locals[name] = None
            self._unfilled.add(name)
            self._take(";")
        elif self.code.tokens[self._at : self._at + 3] == ["(", "void", ")"]:
            self._at += 3
            if self.code.tokens[self._at + 1] == "(":
                self._expression()
            else:
                self._take()
            self._take(";")
        elif token in ("ZD_OBSERVE", "ZD_QUIET"):  # the test harness
            while self._take() != ";":
                pass
        elif self.code.tokens[self._at + 1] == "(":
            self._expression()
            self._take(";")
        else:
            self._assign()
        return False

    def _branch(self) -> None:
        self._take("if")
        self._take("(")
        self._compared = None
        self._expression()
        self._take(")")
        if self._compared and self._compared[1] == "<":
            self._assume(self._compared[0], below=self._compared[2])
        before = _copy(self._locals)
        returned = self._block()
        self._narrow.clear()
        self._locals = before if returned else _join(before, self._locals)

    def _loop(self) -> None:
        """Run a counting loop step by step; where its ends are not known, for any index at once."""
        self._take("for")
        self._take("(")
        kind, name = self._take(), self._take()
        self._take("=")
        first = self._expression()
        self._take(";")
        self._take(name)
        operator = self._take()
        if operator not in ("<", "<="):
            raise NotUnderstoodError(f"{self.code.places[self._at]}: a loop while {operator}")
        end = self._expression()
        if operator == "<=":
            end = Value(end.low + 1, end.high + 1, end.type)
        self._take(";")
        for expected in (name, "++", ")"):
            self._take(expected)
        body = self._at
        if (first.low, end.low) == (first.high, end.high):
            for index in range(first.low, end.low):
                self._locals[name] = Value(index, index, kind)
                self._at = body
                self._block()
        else:
            self._locals[name] = Value(first.low, max(end.high - 1, first.low), kind)
            once = before = _copy(self._locals)
            for _ in range(2):
                once, self._at = _copy(self._locals), body
                self._block()
                self._locals = _join(before, self._locals)
            if once != self._locals:
                raise NotUnderstoodError(f"{self.code.places[body]}: a loop that goes on growing")
        self._locals.pop(name, None)
        self._at = self.code.close[body] + 1

    def _declare(self) -> None:
        constant = self._token == "const"
        if constant:
            self._take()
        kind, name = self._take(), self._take()
        if name in self._locals:
            raise NotUnderstoodError(f"{self.code.places[self._at]}: {name} hides another")
        sizes = []
        while self._token == "[":
            sizes.append(self._take_size())
        if name == "sum" or (constant and kind == "int32_t"):
            self.pending, self.shift = {}, None
        low, high = TYPES.get(kind, (0, 0))
        value = make_array(kind, [], low, high)
        if self._token == "=" and sizes:
            self._take()
            value = self._read_list(kind, sizes[0])
        elif self._token == "=" and kind in TYPES:
            self._take()
            found = self._expression()
            # a copy of a field, and nothing else, is known to be one
            place = found.place if self.code.tokens[self._at - 2] == "->" else ""
            value = self.convert(found, kind)
            plain = replace(value, reach=0, place=place)
            value = value if name == "sum" else plain
            if constant and kind == "int32_t" and name != "sum":
                self.note(name, value.low, value.high, 32)
                self._note_pending(name)
        else:
            while self._token != ";":
                self._take()
        if sizes and isinstance(value, Value):
            value = Array([value] * sizes[0], sizes[0])
        self._locals[name] = value
        self._take(";")

    def _read_list(self, kind: str, size: int) -> Array:
        cells = []
        self._take("{")
        while self._token != "}":
            cells.append(self.convert(self._expression(), kind))
            if self._token == ",":
                self._take()
        self._take("}")
        cells += [Value(0, 0, kind)] * (size - len(cells))
        return Array(cells, size)

    def _note_pending(self, name: str) -> None:
        """Note what was computed on the way to a node's value."""
        for last, (low, high, bits) in self.pending.items():
            self.note(f"{name}.{last}", low, high, bits)
        if self.shift is not None:
            self.shifts[f"{name}.shift"] = self.shift
        self.pending, self.shift = {}, None

    def _assign(self) -> None:
        """x = e; x op= e; x++; where x is a variable, a field, or an element of either."""
        name = self._take()
        is_field = self._token == "->"
        if is_field:
            self._take()
            name = self._take()
        holder, at = None, Value(0, 0)
        target = self._fields[name] if is_field else self._locals[name]
        before = self._narrow.get(name, target)
        while self._token == "[":
            self._take()
            at = self._expression()
            self._take("]")
            holder, target = target, None
            try:
                target = holder.cells[holder.at(at)[0]]
            except IndexError as error:
                self.fail(str(error))
                target = holder.cells[0]
        operator = self._take()
        rest = " ".join(self.code.tokens[self._at : self._at + 10])
        if m := re.match(r"\( (\w+) < (\d+) \) \? 1 : 0 ;", rest if operator == "+=" else ""):
            self._count_up(name, before, *m.groups())
            return
        if operator == "++":
            value = self.combine("+", before, Value(1, 1, "uint32_t"))
        else:
            value = self._expression()
            if operator != "=":
                value = self.combine(operator[0], target, value)
        self._take(";")
        if is_field:
            self._stored.add(name)
            if value.low < target.low or value.high > target.high:
                self.fail(
                    f"s->{name} becomes {value.low} .. {value.high}; the state check admits"
                    f" {target.low} .. {target.high}"
                )
        elif holder is not None:
            where = f"{self.row_of if name == 'result' else name}[{at.low}]"
            found = self._locals.get("sum", value)
            if at.low == at.high and value.type != "uint32_t":
                bits = 64 if found.type == "int64_t" else 32
                self.note(where, -found.reach, found.reach, bits)
                if name == "result" and "limits" in self.pending:
                    self.note(f"{where}.limit", *self.pending["limits"][:2], 16)
                self.pending.clear()
                self._note_pending(where)
            for cell in holder.at(at):
                holder.cells[cell] = replace(value, reach=0, place="")
        else:
            self._locals[name] = self.convert(value, target.type)

    def _count_up(self, name: str, before: Value, copied: str, limit: str) -> None:
        """s->name += (copy < limit) ? 1 : 0; where `copy` is what the field held."""
        self._at += 10
        if self._locals[copied].place != name or before.high > int(limit):
            self.fail(f"s->{name} is not counted up to {limit}")
        stem, _, last = name.rpartition("_")
        self.note(f"{stem}.{last}", before.low, before.high + 1, 32)


def read_lines(tables: Mapping[str, list[int]]) -> list[tuple[int, int]]:
    """Return tanh in Q0.30 at the first and last input of each of the 512 lines of its table.

    Either the 513 nodes are stored, or offset and slope of each line over the position.
    """
    if nodes := tables.get("zd_tanh_nodes_q19"):
        pairs = itertools.pairwise(nodes)
        lines = [(a << 11, (a << 11) + (b - a) * 2047) for a, b in pairs]
    else:
        both = zip(tables["zd_tanh_offset_q30"], tables["zd_tanh_slope_q19"], strict=False)
        lines = []
        for line, (offset, slope) in enumerate(both, -256):
            ends = [slope * ((line << 11) + f) for f in (0, 2047)]
            if max(map(abs, ends)) >= 1 << 31:
                raise NotUnderstoodError(f"line {line} of tanh: the slope's product overflows")
            lines.append((offset + ends[0], offset + ends[1]))
        _require_half(tables)
    if len(lines) != 512:
        raise NotUnderstoodError(f"tanh has {len(lines)} lines; 512 are read")
    return lines


def _require_half(tables: Mapping[str, list[int]]) -> None:
    """Raise where the lines that are read at -Os are not those of the whole table, on either side.

    They lie from 0 on; the last one is level and holds beyond; at -t the offset's sign changes.
    """

    def pair(stem: str) -> list[tuple[int, int]]:
        names = (f"zd_tanh_{stem}offset_q30", f"zd_tanh_{stem}slope_q19")
        return list(zip(*(tables[name] for name in names), strict=False))

    if "zd_tanh_half_offset_q30" in tables:
        half, whole = pair("half_"), pair("")
        sizes = {len(tables[f"zd_tanh_half_{name}"]) for name in ("offset_q30", "slope_q19")}
        half += [half[-1]] * (256 - len(half))
        mirrored = [(-offset, slope) for offset, slope in reversed(half)]
        if len(sizes) > 1 or half[-1][1] != 0 or mirrored + half != whole[:512]:
            raise NotUnderstoodError("zd_tanh_half_* is not the table of the other cores")


def _require_all(name: str, sizes: list[int], test: str) -> None:
    """Raise where a state check does not look at every element of a field, and at no other."""
    counts = re.findall(rf"zd_gru_state_is_sound \( s -> {name} , (\d+)u \)", test)
    for count, body in re.findall(r"k < (\d+)u ; k \+\+ \) \{ (.*?) \{", test):
        counts += [count] * (f"s -> {name} [" in body)
    if any([int(count)] != sizes for count in counts):
        raise NotUnderstoodError(f"the state check looks at {counts} of {name} {sizes}")


def _copy(variables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables as they are now: what can change is copied."""
    return {
        name: value if isinstance(value, Value) else copy.deepcopy(value)
        for name, value in variables.items()
    }


def _join(a: dict[str, Any], b: dict[str, Any]) -> dict[str, Any]:
    """Return variables that can be as in a or as in b."""

    def join(x: Any, y: Any) -> Any:
        if isinstance(x, Array):
            cells = [join(p, q) for p, q in zip(x.cells, y.cells, strict=True)]
            return replace(x, cells=cells)
        return x.join(y) if isinstance(x, Value) else x

    return {name: join(value, b[name]) for name, value in a.items()}
