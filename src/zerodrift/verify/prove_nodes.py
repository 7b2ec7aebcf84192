"""What each node of a model means over terms: at rest, and in a step."""

from collections.abc import Mapping, Sequence

from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.clip import IntegerClip
from zerodrift.operations.counter import IntegerCounter
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.dense import IntegerDense
from zerodrift.operations.elapsed import IntegerElapsed
from zerodrift.operations.exp2 import IntegerExp2
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.head import IntegerHead
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.join import IntegerJoin
from zerodrift.operations.layer_norm import IntegerLayerNorm
from zerodrift.operations.load import IntegerLoad
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.offset import IntegerOffset
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.power import IntegerPower
from zerodrift.operations.product import IntegerProduct
from zerodrift.operations.sum import IntegerSum
from zerodrift.verify.prove_elapsed import say_lowpass, say_time
from zerodrift.verify.prove_kernels import (
    RELAX_STEPS,
    Layers,
    Numbered,
    TermArithmetic,
    find_exp2,
    find_power,
)
from zerodrift.verify.prove_layer_norm import say_norm
from zerodrift.verify.prove_layers import (
    join_states,
    list_layers,
    read_norm,
    read_power,
    split_states,
)
from zerodrift.verify.prove_state import DRIFT, State
from zerodrift.verify.prove_terms import Terms, UndecidedError, Whole


class NodeMeaning(TermArithmetic):
    """The meaning of each node of a model."""

    def __init__(self, terms: Terms, model: IntegerModel) -> None:
        """Read the layers."""
        super().__init__(terms)
        self.model = model
        self.span = self.number(0)
        """Of a variable step: the time since the last one."""
        found = [layer for node in model.recurrents for layer in list_layers(node)]
        self.layers = Layers(terms, found)

    def select(self, table: dict[int, Whole], at: Whole) -> Whole:
        """Return the table's entry at a place within its range."""
        return self.terms.select(at, {i: table[i] for i in range(at.low, at.high + 1)})

    def rest_of(self, node: IntegerNode, values: Mapping[str, list[Whole]], settled: bool) -> State:
        """Return a node's fields at rest under the values of those before it."""
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
        return join_states(node, h_all, c_all)

    def step_node(
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
            newer = x if node.steps == 1 else self.select(cells, after)
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
            h_all, c_all = split_states(node, layers, state)
            h_all, c_all = self._step_all(layers, x, h_all, c_all)
            return join_states(node, h_all, c_all), h_all[-1]
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
