"""What a model's file says, step by step, over terms: the meaning that the C must have.

The fields of a model's state in the C, and what a sound state holds in them.

Written from docs/reference/integer-arithmetic.md and integer-layers.md, node by node; reads the
integer model and nothing of the C. The tests evaluate it beside the reference. The state is that of
the C: a ring of samples with the place of the oldest, which stands for them in their order.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from zerodrift_proof.equality.model import (
    Conversion,
    Flag,
    Model,
)
from zerodrift_proof.equality.node import DRIFT, Ends, Field, Meaning, Moment, State
from zerodrift_proof.equality.rules import LONGEST, say_fast
from zerodrift_proof.equality.syntax import TYPES
from zerodrift_proof.equality.terms import Terms, UndecidedError, Whole

__all__ = ["DRIFT", "State"]

IDENTITY, STEPS, PREVIOUS = "identity", "steps", "previous_temperature"
CHECK, SLEPT = "check", "slept_us"
ANSWERED, TARE, TARED = "answered", "tare", "tared"
"""Fields of the state that no node has."""


def count_warm_up(model: Model) -> int:
    """Return where the count of steps ends."""
    return max(model.guards.warm_up_steps, 1)


def list_fields(model: Model) -> list[Field]:
    """Return the fields of a model's state, in the order of the C."""
    channels, full = model.channel_names, count_warm_up(model)
    thermometer = model.guards.temperature_channel
    kinds = [f"int{channel.bits}_t" for channel in model.channels]
    fields = [Field(PREVIOUS, kinds[thermometer])]
    fields += [Field(f"last_{channels[k]}", kinds[k]) for k in model.held]
    if model.variable_step:
        fields.append(Field(SLEPT, "int64_t", (), 0, LONGEST))
    if model.tare:
        fields.append(Field(ANSWERED, "int32_t", (len(model.outputs),)))
        fields.append(Field(TARE, "int32_t", (len(model.outputs),)))
        fields.append(Field(TARED, "int32_t", (), 0, 2))
    if model.feeds_back:
        fields.append(Field(DRIFT, "int32_t", (len(model.outputs),)))
    ranges: dict[str, Ends] = {}
    for node in model.nodes:
        given = [ranges[name] for name in node.inputs]
        fields += node.list_fields(given)
        ranges[node.name] = node.bound(given)
    if model.guarded:
        fields.sort(key=lambda f: -int(f.type.strip("uint_")))
    first = [Field(IDENTITY, "uint32_t"), Field(STEPS, "uint32_t", (), 0, full)]
    last = [Field(CHECK, "uint32_t")] if model.guarded else []
    return [*first, *fields, *last]


START_PASSES = 4


@dataclass
class Advance:
    """What the nodes of a step give."""

    state: State
    values: dict[str, list[Whole]]
    drift: list[Whole]
    clamped: Whole


@dataclass
class Outcome:
    """What a step leaves."""

    state: State
    drift: list[Whole]
    flags: Whole


class Specification(Meaning):
    """The meaning of a model."""

    def __init__(self, terms: Terms, model: Model) -> None:
        """Read the layers and what the state may hold."""
        super().__init__(terms, [one for node in model.recurrents for one in node.numbered])
        self.model = model
        self.channels = model.channel_names
        self.full = count_warm_up(model)
        self.fields = list_fields(model)

    # --- the state

    def blank(self) -> State:
        """Return the state after init."""
        state = {f.name: [self.number(0)] * f.count for f in self.fields}
        state[IDENTITY] = [self.number(self.model.identity)]
        return self._sum_up(state)

    def is_sound(self, state: State) -> Whole:
        """Return whether a state may be stepped, its checksum apart (flag 16 in section 5)."""
        terms, model = self.terms, self.model
        own = terms.equal(state[IDENTITY][0], self.number(model.identity))
        steps = state[STEPS][0]
        wrong = [terms.less(self.number(self.full), steps)]
        always = terms.both([own, terms.negate(terms.either(wrong))])
        fields = [(f.name, f.low, f.high, f.type) for f in self.fields]
        outside = []
        for name, low, high, kind in fields:
            if name in (STEPS, IDENTITY, CHECK) or low is None or high is None:
                continue
            for cell in state[name]:
                outside.append(terms.less(cell, self.number(max(low, TYPES[kind][0]))))
                outside.append(terms.less(self.number(high), cell))
        if model.feeds_back:
            for k, cell in enumerate(state[DRIFT]):
                outside.append(terms.less(cell, self.number(model.drift.low[k])))
                outside.append(terms.less(self.number(model.drift.high[k]), cell))
        inside = terms.negate(terms.either([*wrong, *outside]))
        new = terms.equal(steps, self.number(0))
        return terms.choose(new, always, terms.both([own, inside]))

    def _sum_up(self, state: State) -> State:
        """Let a guarded state bear its checksum."""
        return {**state, CHECK: [self.checksum(state)]} if self.model.guarded else state

    def checksum(self, state: State) -> Whole:
        """Return what stands for the checksum over all other fields."""
        row = [t for f in self.fields if f.name != CHECK for t in state[f.name]]
        return sum_up(self.terms, row)

    # --- one step

    def convert(self, raw: Sequence[Whole]) -> list[Whole]:
        """Return the channels' codes of what the chip is given (2.2)."""
        codes = []
        for channel, code in zip(self.model.channels, raw, strict=True):
            by = channel.conversion
            codes.append(code if by is None else self._convert_one(by, code))
        return codes

    def _convert_one(self, by: Conversion, r: Whole) -> Whole:
        terms = self.terms
        if by.junction is not None:
            raise UndecidedError(
                "the conversion of a thermocouple with a cold junction has no rule"
            )
        found = r if by.is_plain else self._look_up(by, r)
        if by.none is None:
            return found
        missing = [terms.less(r, self.number(by.begin)), terms.less(self.number(by.end), r)]
        if by.lacks is not None:
            missing.append(terms.equal(r, self.number(by.lacks)))
        return terms.choose(terms.either(missing), self.number(by.none), found)

    def _look_up(self, by: Conversion, r: Whole) -> Whole:
        terms, bits = self.terms, by.block_bits
        first = {i: self.number(n) for i, n in enumerate(by.first)}
        nodes = {i: self.number(n) for i, n in enumerate(by.nodes)}
        place = terms.subtract(self.saturate(r, by.low, by.high), self.number(by.low))
        block = terms.shift(place, bits)
        begin = self.select(first, block)
        end = self.select(first, terms.add(block, self.number(1)))
        most = max(b - a for a, b in pairwise(by.first))
        parts = self.saturate(terms.subtract(end, begin), 1, most)
        at = terms.multiply(terms.modulo(place, bits), parts)
        line = terms.add(begin, terms.shift(at, bits))
        line = self.saturate(line, 0, len(by.nodes) - 2)
        left = self.select(nodes, line)
        rise = terms.subtract(self.select(nodes, terms.add(line, self.number(1))), left)
        total = terms.add(self.number(1 << by.shift >> 1), terms.scale(left, 1 << bits))
        total = terms.add(total, terms.multiply(rise, terms.modulo(at, bits)))
        return self.saturate(terms.shift(total, by.shift), by.lowest, by.highest)

    def lacks(self, codes: Sequence[Whole]) -> Whole:
        """Return whether some channel has no reading (2.1)."""
        found = [
            self.terms.equal(codes[k], self.number(none))
            for k, channel in enumerate(self.model.channels)
            if (none := channel.no_reading) is not None
        ]
        return self.terms.either(found)

    def hold(self, state: State, codes: Sequence[Whole]) -> list[Whole]:
        """Return the codes with the last reading in the place of each that is none."""
        out = list(codes)
        for k in self.model.optional:
            thermometer = k == self.model.guards.temperature_channel
            last = "previous_temperature" if thermometer else f"last_{self.channels[k]}"
            missing = self.lack(codes, k)
            out[k] = self.terms.choose(missing, state[last][0], codes[k])
        return out

    def lack(self, codes: Sequence[Whole], channel: int) -> Whole:
        """Return whether one channel has no reading."""
        none = self.model.channels[channel].no_reading
        assert none is not None
        return self.terms.equal(codes[channel], self.number(none))

    def rest(self, state: State, codes: Sequence[Whole], settled: bool) -> State:
        """Return the state at rest at codes (section 5), checksum and steps apart."""
        passes = START_PASSES if self.model.feeds_back else 0
        if self.model.feeds_back:
            state = {**state, "drift": [self.number(0)] * len(self.model.outputs)}
        for _ in range(passes):
            resting = self._rest_once(state, codes, settled)
            drift = self.advance(resting, codes).drift
            state = {**state, "drift": drift}
        return self._rest_once(state, codes, settled)

    def _rest_once(self, state: State, codes: Sequence[Whole], settled: bool) -> State:
        """Put every node to rest under the values of those before it at rest."""
        at_rest: dict[str, list[Whole]] = {}
        own: State = {}
        stepped: dict[str, list[Whole]] = {}
        streams = sum(node.streams for node in self.model.recurrents)
        for node in self.model.nodes[:-1]:
            below = at_rest if streams > 1 else stepped
            rests = node.rest(self, below, settled)
            own |= rests
            merged = {**state, **rests}
            stepped[node.name] = node.step(self, Moment(merged, codes, stepped))[1]
            if streams > 1:
                at_rest[node.name] = node.give_at_rest(self, Moment(merged, codes, at_rest))
        after = {**state, **own}
        guards = self.model.guards
        after[PREVIOUS] = [codes[guards.temperature_channel]]
        for k in self.model.held:
            after[f"last_{self.channels[k]}"] = [codes[k]]
        return after

    def advance(self, state: State, codes: Sequence[Whole]) -> Advance:
        """Compute all nodes once."""
        values: dict[str, list[Whole]] = {}
        after = dict(state)
        for node in self.model.nodes[:-1]:
            own, values[node.name] = node.step(self, Moment(state, codes, values))
            after |= own
        last = self.model.drift
        drift, clamped = last.answer(self, values)
        if self.model.feeds_back:
            after[DRIFT] = drift
        values[last.name] = drift
        return Advance(after, values, drift, clamped)

    # --- what a call leaves

    def settle(self, codes: Sequence[Whole]) -> State:
        """Return the state after settle at codes that are readings."""
        state = self.rest(self.blank(), codes, settled=True)
        return self._sum_up({**state, STEPS: [self.number(self.full)]})

    def damage(self) -> Outcome:
        """Return what a step leaves of a state that is not sound."""
        drift = [self.number(0)] * len(self.model.outputs)
        return Outcome(self.blank(), drift, self.number(Flag.DAMAGED))

    def wait(self, state: State) -> Outcome:
        """Return what a step leaves that has nothing to begin with."""
        flags = Flag.NO_READING + Flag.WARMING_UP * (self.model.guards.warm_up_steps > 0)
        drift = [self.number(0)] * len(self.model.outputs)
        return Outcome(state, drift, self.number(flags))

    def step(
        self, state: State, codes: Sequence[Whole], held: Sequence[Whole], lacks: Whole
    ) -> tuple[Outcome, Advance]:
        """Return what a step leaves of a state that has begun.

        Args:
            state: as it was.
            codes: as they are given.
            held: with the last reading in the place of each that is none.
            lacks: whether some code is none.
        """
        del codes
        terms, guards = self.terms, self.model.guards
        done = self.advance(state, held)
        drift, limited = done.drift, done.clamped
        if self.model.tare:
            drift, more = self._count_from(state, done)
            limited = terms.either([limited, more])
        previous, now = state[PREVIOUS][0], held[guards.temperature_channel]
        most = self.number(guards.rate_max)
        low, high = self.number(guards.temperature_low), self.number(guards.temperature_high)
        steps = state[STEPS][0]
        beyond = []
        for channel, least, largest in guards.ranges:
            beyond.append(terms.less(held[channel], self.number(least)))
            beyond.append(terms.less(self.number(largest), held[channel]))
        if self.model.variable_step:
            period = self.number(self.model.period_us)
            fast = say_fast(terms, [now, previous, most, self.span, period])
        else:
            rises = terms.less(most, terms.subtract(now, previous))
            falls = terms.less(most, terms.subtract(previous, now))
            fast = terms.either([rises, falls])
        raised = {
            Flag.CLAMPED: limited,
            Flag.WARMING_UP: terms.less(steps, self.number(guards.warm_up_steps)),
            Flag.TEMPERATURE_RANGE: terms.either([terms.less(now, low), terms.less(high, now)]),
            Flag.RATE_RANGE: fast,
            Flag.INPUT_RANGE: terms.either(beyond),
            Flag.NO_READING: lacks,
        }
        if self.model.tare:
            raised[Flag.TARED] = terms.equal(done.state[TARED][0], self.number(2))
        flags = self.number(0)
        for bit, truth in raised.items():
            flags = terms.add(flags, terms.scale(truth, bit))
        after = dict(done.state)
        after[PREVIOUS] = [now]
        for k in self.model.held:
            after[f"last_{self.channels[k]}"] = [held[k]]
        if self.model.variable_step:
            after[SLEPT] = [self.number(0)]
        after[STEPS] = [terms.add(steps, terms.less(steps, self.number(self.full)))]
        return Outcome(self._sum_up(after), drift, flags), done

    def _count_from(self, state: State, done: Advance) -> tuple[list[Whole], Whole]:
        """Keep the answers in the state after a step; return them from the tare on, and whether
        one of them is limited."""
        terms = self.terms
        tared = terms.equal(state[TARED][0], self.number(2))
        drift, limited = [], []
        for answer, tare in zip(done.drift, state[TARE], strict=True):
            wide = terms.subtract(answer, tare)
            counted = self.saturate(wide, -(2**31), 2**31 - 1)
            drift.append(terms.choose(tared, counted, answer))
            limited.append(terms.negate(terms.equal(counted, wide)))
        done.state[ANSWERED] = list(done.drift)
        done.state[TARED] = [terms.choose(tared, state[TARED][0], self.number(1))]
        return drift, terms.both([tared, terms.either(limited)])

    def tare(self, state: State) -> State:
        """Return the state after `tare`, of a state that has given an answer."""
        return self._sum_up({**state, TARE: state[ANSWERED], TARED: [self.number(2)]})

    def untare(self, state: State) -> State:
        """Return the state after `untare`, of a state that is tared."""
        return self._sum_up({**state, TARED: [self.number(1)]})


def sum_up(terms: Terms, row: Sequence[Whole]) -> Whole:
    """Return what stands for the checksum over numbers."""
    from zerodrift_proof.equality.terms import Opaque

    known = Opaque("checksum", lambda _: (0, 2**32 - 1))
    return terms.call(known, row, terms.row(row))
