"""What a model's file says, step by step, over terms: the meaning that the C must have.

Written from docs/reference/integer-arithmetic.md and integer-layers.md, node by node; reads the
integer model and nothing of the C. The tests evaluate it beside the reference. The state is that
of the C: a ring of samples with the place of the oldest, which stands for them in their order.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise

from zerodrift.codegen.names import name_channels
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_INPUT_RANGE,
    FLAG_NO_READING,
    FLAG_RATE_RANGE,
    FLAG_TARED,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
)
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.conversion import IntegerConversion
from zerodrift.operations.counter import IntegerCounter
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.dense import IntegerDense
from zerodrift.operations.elapsed import IntegerElapsed
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import IntegerGru
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.intervals import Bound
from zerodrift.operations.join import IntegerJoin
from zerodrift.operations.layer_norm import IntegerLayerNorm
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.operations.lstm.cell import IntegerLstm
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.offset import IntegerOffset
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.power import IntegerPower
from zerodrift.operations.product import IntegerProduct
from zerodrift.operations.recurrent import IntegerRecurrent
from zerodrift.operations.sum import IntegerSum
from zerodrift.verify.c_values import TYPES
from zerodrift.verify.prove_elapsed import LONGEST, say_fast, say_lowpass, say_time
from zerodrift.verify.prove_kernels import (
    CELL_LIMIT,
    H_LIMIT_Q30,
    RELAX_STEPS,
    Layers,
    Numbered,
    Power,
    TermArithmetic,
    find_exp2,
    find_power,
)
from zerodrift.verify.prove_layer_norm import Normalisation, say_norm
from zerodrift.verify.prove_terms import Terms, UndecidedError, Whole

State = dict[str, list[Whole]]
"""Field of the C's state -> its numbers."""
START_PASSES = 4
IDENTITY, STEPS, PREVIOUS = "identity", "steps", "previous_temperature"
DRIFT, CHECK, SLEPT = "drift", "check", "slept_us"
ANSWERED, TARE, TARED = "answered", "tare", "tared"
"""Fields of the state that no node has."""


@dataclass(frozen=True)
class Field:
    """A field of the state."""

    name: str
    type: str
    sizes: tuple[int, ...] = ()
    low: int | None = None
    """What a sound state holds there; None: anything."""
    high: int | None = None

    @property
    def count(self) -> int:
        """How many numbers it holds."""
        count = 1
        for size in self.sizes:
            count *= size
        return count


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


@dataclass
class Specification(TermArithmetic):
    """The meaning of a model."""

    terms: Terms
    model: IntegerModel
    layers: Layers = field(init=False)

    def __post_init__(self) -> None:
        """Read the layers and what the state may hold."""
        self.channels = name_channels(self.model)
        self.span = self.number(0)
        """Of a variable step: the time since the last one."""
        self.full = max(self.model.guards.warm_up_steps, 1)
        found = [layer for node in self.model.recurrents for layer in list_layers(node)]
        self.layers = Layers(self.terms, found)
        self.bounds = {bound.where: bound for bound in self.model.prove()}
        self.fields = self._list_fields()

    # --- the state

    def _list_fields(self) -> list[Field]:
        model = self.model
        thermometer = model.guards.temperature_channel
        kinds = [f"int{channel.bits}_t" for channel in model.channels]
        fields = [Field("previous_temperature", kinds[thermometer])]
        fields += [Field(f"last_{self.channels[k]}", kinds[k]) for k in model.held]
        if model.variable_step:
            fields.append(Field(SLEPT, "int64_t", (), 0, LONGEST))
        if model.tare:
            fields.append(Field(ANSWERED, "int32_t", (len(model.outputs),)))
            fields.append(Field(TARE, "int32_t", (len(model.outputs),)))
            fields.append(Field(TARED, "int32_t", (), 0, 2))
        if model.feeds_back:
            fields.append(Field("drift", "int32_t", (len(model.outputs),)))
        for node in model.nodes:
            fields += self._list_own(node)
        if model.guarded:
            fields.sort(key=lambda f: -int(f.type.strip("uint_")))
        first = [Field("identity", "uint32_t"), Field("steps", "uint32_t", (), 0, self.full)]
        last = [Field("check", "uint32_t")] if model.guarded else []
        return [*first, *fields, *last]

    def _range(self, where: str) -> Bound:
        return self.bounds[where]

    def _list_own(self, node: IntegerNode) -> list[Field]:
        name = node.name
        match node:
            case IntegerLowpass():
                v = self._range(f"{name}.v").interval
                return [Field(f"{name}_v", "int64_t", (), v.low, v.high)]
            case IntegerLowpassAfter():
                own = [("before", "int32_t"), ("waiting", "int32_t"), ("y", "int64_t")]
                ranges = [self._range(f"{name}.{part}").interval for part, _ in own]
                return [
                    Field(f"{name}_{part}", kind, (), x.low, x.high)
                    for (part, kind), x in zip(own, ranges, strict=True)
                ]
            case IntegerElapsed():
                return [Field(f"{name}_time", "int64_t", (), 0, node.most_us)]
            case IntegerPlay():
                y = self._range(f"{name}.y").interval
                return [Field(f"{name}_y", "int32_t", (), y.low, y.high)]
            case IntegerCounter():
                return [Field(f"{name}_count", "int32_t", (), 0, node.limit)]
            case IntegerDelay():
                x = self._range(f"{name}.line").interval
                return [
                    Field(f"{name}_line", "int32_t", (node.steps,), x.low, x.high),
                    Field(f"{name}_oldest", "uint16_t", (), 0, node.steps - 1),
                ]
            case IntegerGruLayer() | IntegerLstmLayer() if node.window:
                inputs = node.layers[0].inputs
                return [
                    Field(f"{name}_window", "int16_t", (node.window, inputs)),
                    Field(f"{name}_oldest", "uint16_t", (), 0, node.window - 1),
                ]
            case IntegerGruLayer():
                hidden = [layer.hidden for layer in node.layers]
                limit = H_LIMIT_Q30
                fields = [Field(f"{name}_h_q30", "int32_t", (hidden[-1],), -limit, limit)]
                if len(hidden) > 1:
                    lower = (sum(hidden[:-1]),)
                    fields.append(Field(f"{name}_lower_q30", "int32_t", lower, -limit, limit))
                return fields
            case IntegerLstmLayer():
                units = (sum(layer.hidden for layer in node.layers),)
                return [
                    Field(f"{name}_cell", "int32_t", units, -CELL_LIMIT, CELL_LIMIT),
                    Field(f"{name}_h_q30", "int32_t", units, -H_LIMIT_Q30, H_LIMIT_Q30),
                ]
        return []

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
            if name in ("steps", "identity", "check") or low is None or high is None:
                continue
            for cell in state[name]:
                outside.append(terms.less(cell, self.number(max(low, TYPES[kind][0]))))
                outside.append(terms.less(self.number(high), cell))
        if model.feeds_back:
            for k, cell in enumerate(state[DRIFT]):
                outside.append(terms.less(cell, self.number(int(model.drift.low[k]))))
                outside.append(terms.less(self.number(int(model.drift.high[k])), cell))
        inside = terms.negate(terms.either([*wrong, *outside]))
        new = terms.equal(steps, self.number(0))
        return terms.choose(new, always, terms.both([own, inside]))

    def _sum_up(self, state: State) -> State:
        """Let a guarded state bear its checksum."""
        return {**state, "check": [self.checksum(state)]} if self.model.guarded else state

    def checksum(self, state: State) -> Whole:
        """Return what stands for the checksum over all other fields."""
        row = [t for f in self.fields if f.name != "check" for t in state[f.name]]
        return sum_up(self.terms, row)

    # --- one step

    def convert(self, raw: Sequence[Whole]) -> list[Whole]:
        """Return the channels' codes of what the chip is given (2.2)."""
        codes = []
        for channel, code in zip(self.model.channels, raw, strict=True):
            by = channel.conversion
            codes.append(code if by is None else self._convert_one(by, code))
        return codes

    def _convert_one(self, by: IntegerConversion, r: Whole) -> Whole:
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

    def _look_up(self, by: IntegerConversion, r: Whole) -> Whole:
        terms, bits = self.terms, by.block_bits
        first = {i: self.number(int(n)) for i, n in enumerate(by.first)}
        nodes = {i: self.number(int(n)) for i, n in enumerate(by.nodes)}
        place = terms.subtract(self.saturate(r, by.low, by.high), self.number(by.low))
        block = terms.shift(place, bits)
        begin = self._select(first, block)
        end = self._select(first, terms.add(block, self.number(1)))
        most = max(b - a for a, b in pairwise(by.first))
        parts = self.saturate(terms.subtract(end, begin), 1, most)
        at = terms.multiply(terms.modulo(place, bits), parts)
        line = terms.add(begin, terms.shift(at, bits))
        line = self.saturate(line, 0, len(by.nodes) - 2)
        left = self._select(nodes, line)
        rise = terms.subtract(self._select(nodes, terms.add(line, self.number(1))), left)
        total = terms.add(self.number(1 << by.shift >> 1), terms.scale(left, 1 << bits))
        total = terms.add(total, terms.multiply(rise, terms.modulo(at, bits)))
        return self.saturate(terms.shift(total, by.shift), by.lowest, by.highest)

    def _select(self, table: dict[int, Whole], at: Whole) -> Whole:
        return self.terms.select(at, {i: table[i] for i in range(at.low, at.high + 1)})

    def lacks(self, codes: Sequence[Whole]) -> Whole:
        """Return whether some channel has no reading (2.1)."""
        found = [
            self.terms.equal(codes[k], self.number(int(none)))
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
            rests = self._rest_of(node, below, settled)
            own |= rests
            merged = {**state, **rests}
            stepped[node.name] = self._step(node, merged, codes, stepped)[1]
            if streams > 1:
                if isinstance(node, IntegerRecurrent) and node.streams:
                    at_rest[node.name] = merged[f"{node.name}_h_q30"][-node.width :]
                else:
                    at_rest[node.name] = self._step(node, merged, codes, at_rest)[1]
        after = {**state, **own}
        guards = self.model.guards
        after[PREVIOUS] = [codes[guards.temperature_channel]]
        for k in self.model.held:
            after[f"last_{self.channels[k]}"] = [codes[k]]
        return after

    def _rest_of(
        self, node: IntegerNode, values: Mapping[str, list[Whole]], settled: bool
    ) -> State:
        terms, name, zero = self.terms, node.name, self.number(0)
        match node:
            case IntegerLowpass():
                x = values[node.inputs[0]][0]
                return {f"{name}_v": [terms.scale(x, 2**24 - node.c_q24)]}
            case IntegerLowpassAfter():
                x = values[node.inputs[0]][0]
                y = terms.scale(x, 2**24)
                return {f"{name}_before": [x], f"{name}_waiting": [zero], f"{name}_y": [y]}
            case IntegerElapsed():
                return {f"{name}_time": [zero]}
            case IntegerPlay():
                return {f"{name}_y": values[node.inputs[0]]}
            case IntegerCounter():
                return {f"{name}_count": [zero]}
            case IntegerDelay():
                x = values[node.inputs[0]][0]
                return {f"{name}_line": [x] * node.steps, f"{name}_oldest": [zero]}
            case IntegerGruLayer() | IntegerLstmLayer() if node.window:
                features = values[node.inputs[0]]
                return {f"{name}_window": features * node.window, f"{name}_oldest": [zero]}
            case IntegerGruLayer() | IntegerLstmLayer():
                return self._rest_recurrent(node, values[node.inputs[0]], settled)
        return {}

    def _rest_recurrent(
        self, node: IntegerGruLayer | IntegerLstmLayer, x: list[Whole], settled: bool
    ) -> State:
        h_all: list[list[Whole]] = []
        c_all: list[list[Whole]] = []
        for layer in list_layers(node):
            h = [self.number(0)] * layer.hidden
            c = h if layer.kind == "lstm" else []
            for _ in range(RELAX_STEPS if settled else 0):
                h, c = self.layers.step(layer.name, x, h, c, relaxing=True)
            h_all.append(h)
            c_all.append(c)
            x = [self.round_shift(one, 15) for one in h]
        return _join(node, h_all, c_all)

    def advance(self, state: State, codes: Sequence[Whole]) -> Advance:
        """Compute all nodes once."""
        values: dict[str, list[Whole]] = {}
        after = dict(state)
        for node in self.model.nodes[:-1]:
            own, values[node.name] = self._step(node, state, codes, values)
            after |= own
        terms, last = self.terms, self.model.drift
        drift, clamped = [], []
        for k in range(last.width):
            factors = [int(c) for c in last.coefficients[k]]
            signals = [values[name][0] for name in last.signals]
            total = self.dot(int(last.bias[k]), factors, signals)
            if last.head:
                below = values[last.inputs[-1]][k]
                total = terms.add(total, terms.scale(below, int(last.head_coefficients[k])))
            wide = terms.shift(total, int(last.shift[k]))
            limited = self.saturate(wide, int(last.low[k]), int(last.high[k]))
            clamped.append(terms.negate(terms.equal(limited, wide)))
            drift.append(limited)
        if self.model.feeds_back:
            after[DRIFT] = drift
        values[last.name] = drift
        return Advance(after, values, drift, terms.either(clamped))

    def _step(
        self,
        node: IntegerNode,
        state: State,
        codes: Sequence[Whole],
        values: Mapping[str, list[Whole]],
    ) -> tuple[State, list[Whole]]:
        """Return a node's fields after the step, and its output."""
        terms, name = self.terms, node.name
        given = [values[n] for n in node.inputs]
        match node:
            case IntegerInput():
                code = self.saturate(codes[node.channel], node.low, node.high)
                return {}, [
                    terms.scale(terms.subtract(code, self.number(node.origin)), 1 << node.shift)
                ]
            case IntegerLoad():
                load = terms.subtract(codes[node.channel], state[DRIFT][node.output])
                return {}, [terms.scale(self.saturate(load, node.low, node.high), 1 << node.shift)]
            case IntegerCounter():
                count = state[f"{name}_count"][0]
                more = terms.less(count, self.number(node.limit))
                return {f"{name}_count": [terms.add(count, more)]}, [count]
            case IntegerOffset():
                return {}, [terms.subtract(given[0][0], self.number(node.offset))]
            case IntegerSum():
                total = self.dot(node.bias, node.coefficients, [g[0] for g in given])
                return {}, [self.saturate(terms.shift(total, node.shift), node.low, node.high)]
            case IntegerProduct():
                product = terms.multiply(given[0][0], given[1][0])
                rounded = self.round_shift(product, node.shift)
                return {}, [self.saturate(rounded, node.low, node.high)]
            case IntegerExp2():
                total = self.dot(node.bias, [node.coefficient], [given[0][0]])
                t = self.saturate(terms.shift(total, node.shift), node.low, node.high)
                return {}, [terms.call(find_exp2(terms, node.top), [t])]
            case IntegerPower():
                return {}, [terms.call(find_power(terms, name, read_power(node)), [given[0][0]])]
            case IntegerLowpass():
                return self._lowpass(node, state, given[0][0])
            case IntegerLowpassAfter():
                return self._lowpass_after(node, state, given[0][0])
            case IntegerElapsed():
                time, ticks = say_time(
                    terms, state[f"{name}_time"][0], self.span, node.limit, node.bits
                )
                return {f"{name}_time": [time]}, [ticks]
            case IntegerDelay():
                return self._delay(node, state, given[0][0])
            case IntegerClip():
                return {}, [self.saturate(given[0][0], node.low, node.high)]
            case IntegerPlay():
                x, half = given[0][0], self.number(node.half_width)
                low, high = terms.subtract(x, half), terms.add(x, half)
                y = terms.clamp(state[f"{name}_y"][0], low, high)
                return {f"{name}_y": [y]}, [y]
            case IntegerFeatures():
                signals = [g[0] for g in given]
                out = []
                for i in range(node.width):
                    total = self.dot(int(node.bias[i]), [int(m) for m in node.matrix[i]], signals)
                    shifted = terms.shift(total, int(node.shift[i]))
                    out.append(self.saturate(shifted, -(2**15), 2**15 - 1))
                return {}, out
            case IntegerGruLayer() | IntegerLstmLayer():
                return self._recurrent(node, state, given[0])
            case IntegerDense():
                return {}, self._dense(node, given[0])
            case IntegerLayerNorm():
                copies = [self.round_shift(one, 15) for one in given[0]]
                return {}, say_norm(terms, read_norm(node), copies)
            case IntegerHead():
                copies = given[0]
                if node.kind == "head":
                    copies = [self.round_shift(one, 15) for one in copies]
                return {}, [self.dot(0, [int(w) for w in row], copies) for row in node.weights]
            case IntegerJoin():
                return {}, [
                    self.round_shift(one, int(by))
                    for part, by in zip(given, node.shift, strict=True)
                    for one in part
                ]
        return {}, self._plain(node, given)

    def _plain(self, node: IntegerNode, given: list[list[Whole]]) -> list[Whole]:
        terms = self.terms
        if node.kind in ("difference", "maximum", "minimum"):
            rules = {
                "difference": terms.subtract,
                "maximum": terms.maximum,
                "minimum": terms.minimum,
            }
            return [rules[node.kind](given[0][0], given[1][0])]
        raise UndecidedError(f"'{node.kind}' has no rule")

    def _lowpass(self, node: IntegerLowpass, state: State, x: Whole) -> tuple[State, list[Whole]]:
        terms, name = self.terms, node.name
        v = state[f"{name}_v"][0]
        y = terms.add(v, terms.scale(x, node.c_q24))
        gap = self.round_shift(terms.subtract(terms.scale(x, 1 << 24), y), 22)
        moved = self.round_shift(terms.scale(gap, node.m_q31), node.shift)
        return {f"{name}_v": [terms.add(v, moved)]}, [self.round_shift(y, 24)]

    def _lowpass_after(
        self, node: IntegerLowpassAfter, state: State, x: Whole
    ) -> tuple[State, list[Whole]]:
        name = node.name
        own = [state[f"{name}_{part}"][0] for part in ("before", "waiting", "y")]
        moved = say_lowpass(self.terms, [*own, x, self.span], node.rate_q31, node.shift)
        after = {"before": moved.before, "waiting": moved.waiting, "y": moved.y}
        return {f"{name}_{part}": [value] for part, value in after.items()}, [moved.out]

    def _delay(self, node: IntegerDelay, state: State, x: Whole) -> tuple[State, list[Whole]]:
        """The oldest place takes the present input; the next one is the oldest then."""
        terms, name, last = self.terms, node.name, node.steps - 1
        line, at = state[f"{name}_line"], state[f"{name}_oldest"][0]
        cells = dict(enumerate(line))
        turn = terms.equal(at, self.number(last))
        after = terms.choose(turn, self.number(0), terms.add(at, self.number(1)))
        older = terms.select(at, cells)
        out = older
        if node.newer_q31:
            newer = x if node.steps == 1 else self._select(cells, after)
            rise = terms.scale(terms.subtract(newer, older), node.newer_q31)
            out = terms.add(older, self.round_shift(rise, 31))
        stored = [
            terms.choose(terms.equal(at, self.number(k)), x, cell) for k, cell in enumerate(line)
        ]
        return {f"{name}_line": stored, f"{name}_oldest": [after]}, [out]

    def _dense(self, node: IntegerDense, below: list[Whole]) -> list[Whole]:
        terms = self.terms
        copies = below
        if node.kind == "dense":
            copies = [self.round_shift(one, 15) for one in below]
        out = []
        for i in range(node.width):
            total = self.dot(int(node.bias[i]), [int(w) for w in node.weights[i]], copies)
            scaled = terms.shift(total, int(node.shift[i]))
            if node.activation == "tanh":
                out.append(self.tanh(scaled))
            else:
                limited = self.saturate(scaled, int(node.low[i]), int(node.high[i]))
                out.append(terms.scale(limited, 1 << 15))
        return out

    def _recurrent(
        self, node: IntegerGruLayer | IntegerLstmLayer, state: State, x: list[Whole]
    ) -> tuple[State, list[Whole]]:
        name, layers = node.name, list_layers(node)
        if not node.window:
            h_all, c_all = _split(node, layers, state)
            h_all, c_all = self._step_all(layers, x, h_all, c_all)
            return _join(node, h_all, c_all), h_all[-1]
        at = state[f"{name}_oldest"][0].exact
        if at is None:
            raise UndecidedError("a window of which the oldest place is not known")
        inputs, window = layers[0].inputs, list(state[f"{name}_window"])
        window[at * inputs : (at + 1) * inputs] = x
        oldest = 0 if at == node.window - 1 else at + 1
        h_all = [[self.number(0)] * layer.hidden for layer in layers]
        c_all = [
            list(h) if layer.kind == "lstm" else [] for h, layer in zip(h_all, layers, strict=True)
        ]
        for k in range(node.window):
            row = (oldest + k) % node.window
            given = window[row * inputs : (row + 1) * inputs]
            h_all, c_all = self._step_all(layers, given, h_all, c_all)
        own = {f"{name}_window": window, f"{name}_oldest": [self.number(oldest)]}
        return own, h_all[-1]

    def _step_all(
        self,
        layers: list[Numbered],
        x: list[Whole],
        h_all: list[list[Whole]],
        c_all: list[list[Whole]],
    ) -> tuple[list[list[Whole]], list[list[Whole]]]:
        after: tuple[list[list[Whole]], list[list[Whole]]] = ([], [])
        for layer, h, c in zip(layers, h_all, c_all, strict=True):
            h_next, c_next = self.layers.step(layer.name, x, h, c, relaxing=False)
            after[0].append(h_next)
            after[1].append(c_next)
            x = [self.round_shift(one, 15) for one in h_next]
        return after

    # --- what a call leaves

    def settle(self, codes: Sequence[Whole]) -> State:
        """Return the state after settle at codes that are readings."""
        state = self.rest(self.blank(), codes, settled=True)
        return self._sum_up({**state, "steps": [self.number(self.full)]})

    def damage(self) -> Outcome:
        """Return what a step leaves of a state that is not sound."""
        drift = [self.number(0)] * len(self.model.outputs)
        return Outcome(self.blank(), drift, self.number(FLAG_DAMAGED))

    def wait(self, state: State) -> Outcome:
        """Return what a step leaves that has nothing to begin with."""
        flags = FLAG_NO_READING + FLAG_WARMING_UP * (self.model.guards.warm_up_steps > 0)
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
            beyond.append(terms.less(held[channel], self.number(int(least))))
            beyond.append(terms.less(self.number(int(largest)), held[channel]))
        if self.model.variable_step:
            period = self.number(self.model.period_us)
            fast = say_fast(terms, [now, previous, most, self.span, period])
        else:
            rises = terms.less(most, terms.subtract(now, previous))
            falls = terms.less(most, terms.subtract(previous, now))
            fast = terms.either([rises, falls])
        raised = {
            FLAG_CLAMPED: limited,
            FLAG_WARMING_UP: terms.less(steps, self.number(guards.warm_up_steps)),
            FLAG_TEMPERATURE_RANGE: terms.either([terms.less(now, low), terms.less(high, now)]),
            FLAG_RATE_RANGE: fast,
            FLAG_INPUT_RANGE: terms.either(beyond),
            FLAG_NO_READING: lacks,
        }
        if self.model.tare:
            raised[FLAG_TARED] = terms.equal(done.state[TARED][0], self.number(2))
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
    from zerodrift.verify.prove_terms import Opaque

    known = Opaque("checksum", lambda _: (0, 2**32 - 1))
    return terms.call(known, row, terms.row(row))


def read_power(node: IntegerPower) -> Power:
    """Return the numbers of a power."""
    return Power(tuple(node.octave), tuple(node.gains), node.low, node.high, node.shift)


def read_norm(node: IntegerLayerNorm) -> Normalisation:
    """Return the numbers of a layer normalisation."""
    rows = (node.align, node.gain.tolist(), node.shift, node.bias.tolist())
    align, gain, shift, bias = (tuple(int(n) for n in row) for row in rows)
    return Normalisation(align, gain, shift, bias, node.epsilon)


def list_layers(node: IntegerNode) -> list[Numbered]:
    """Return the layers of a recurrent node, from the bottom up, named as in the C."""
    if isinstance(node, IntegerGruLayer):
        names = node.name_layers("_")
        return [_read_gru(n, gru) for n, gru in zip(names, node.layers, strict=True)]
    if isinstance(node, IntegerLstmLayer):
        names = node.name_layers("_")
        return [_read_lstm(n, one) for n, one in zip(names, node.layers, strict=True)]
    raise UndecidedError(f"'{node.kind}' has no layers")


def _rows(weights: object, gates: int, hidden: int) -> tuple[tuple[int, ...], ...]:
    """Return weights [G, H, n] as rows, the gates of a unit side by side."""
    import numpy as np

    assert isinstance(weights, np.ndarray)
    listed = weights.tolist()
    return tuple(tuple(listed[g][j]) for j in range(hidden) for g in range(gates))


def _read_gru(name: str, gru: IntegerGru) -> Numbered:
    hidden = gru.hidden
    bias = tuple(int(gru.bias[g][j]) for j in range(hidden) for g in range(4))
    multiplier: tuple[int, ...] = ()
    if gru.multiplier is not None:
        multiplier = tuple(int(gru.multiplier[g][j]) for j in range(hidden) for g in range(3))
    return Numbered(
        name,
        "gru" if gru.reset == "after" else "gru before",
        gru.inputs,
        hidden,
        _rows(gru.w_x, 3, hidden),
        _rows(gru.w_h, 3, hidden),
        bias,
        tuple(int(s) for s in gru.shift),
        multiplier,
        tuple(int(s) for s in gru.multiplier_shift),
    )


def _read_lstm(name: str, lstm: IntegerLstm) -> Numbered:
    hidden = lstm.hidden
    bias = tuple(int(lstm.bias[g][j]) for j in range(hidden) for g in range(4))
    multiplier: tuple[int, ...] = ()
    if lstm.multiplier is not None:
        multiplier = tuple(int(lstm.multiplier[g][j]) for j in range(hidden) for g in range(4))
    return Numbered(
        name,
        "lstm",
        lstm.inputs,
        hidden,
        _rows(lstm.w_x, 4, hidden),
        _rows(lstm.w_h, 4, hidden),
        bias,
        tuple(int(s) for s in lstm.shift),
        multiplier,
        tuple(int(s) for s in lstm.multiplier_shift),
        int(lstm.cell_bits),
    )


def _split(
    node: IntegerRecurrent, layers: list[Numbered], state: State
) -> tuple[list[list[Whole]], list[list[Whole]]]:
    """Return the layers' states and cells, from the bottom up."""
    name = node.name
    if isinstance(node, IntegerLstmLayer):
        h, c = state[f"{name}_h_q30"], state[f"{name}_cell"]
    else:
        h, c = [*state.get(f"{name}_lower_q30", []), *state[f"{name}_h_q30"]], []
    h_all, c_all, at = [], [], 0
    for layer in layers:
        h_all.append(h[at : at + layer.hidden])
        c_all.append(c[at : at + layer.hidden])
        at += layer.hidden
    return h_all, c_all


def _join(node: IntegerRecurrent, h_all: list[list[Whole]], c_all: list[list[Whole]]) -> State:
    """Return the layers' states as the fields of the C."""
    name = node.name
    if isinstance(node, IntegerLstmLayer):
        return {f"{name}_h_q30": [*chain(*h_all)], f"{name}_cell": [*chain(*c_all)]}
    lower = {f"{name}_lower_q30": [*chain(*h_all[:-1])]} if len(h_all) > 1 else {}
    return {f"{name}_h_q30": h_all[-1], **lower}
