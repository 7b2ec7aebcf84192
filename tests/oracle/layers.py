"""Section 4 of docs/reference/integer-arithmetic.md, and docs/reference/integer-layers.md."""

from collections.abc import Sequence
from math import isqrt

from tests.oracle.model_file import Node, check_width, read_gates, read_rows, read_vector
from tests.oracle.primitives import (
    add,
    copy,
    fit,
    mul_high,
    round_shift,
    saturate,
    sigmoid_q31,
    tanh_q30,
)

R, U, N, N_RECURRENT = range(4)
H_LIMIT_Q30 = 2**30 - 2**15 + 1
RELAX_STEPS = 64
HALF_Q31 = 2**30


class Gru:
    """One layer of 4.2: weights, and a step from one state to the next."""

    def __init__(self, gru: Node) -> None:
        """Read the arrays of the model file."""
        self.after = {"after": True, "before": False}[gru["reset"]]
        self.bias = read_rows(gru["bias"])
        self.w_x, self.w_h = read_gates(gru["w_x"]), read_gates(gru["w_h"])
        self.shift, self.multiplier_shift = gru["shift"], gru["multiplier_shift"]
        self.multiplier = gru["multiplier"] and read_rows(gru["multiplier"])
        self.hidden = len(self.w_h[0])
        check_width(self.bias, 32)
        check_width(self.w_x, 16)
        check_width(self.w_h, 8 if self.multiplier else 16)

    def _recur(self, gate: int, unit: int, v: Sequence[int]) -> int:
        row = self.w_h[gate][unit]
        if not self.multiplier:
            return add(0, row, v, 32)
        product = self.multiplier[gate][unit] * add(0, row, v, 32)
        return fit(round_shift(product, self.multiplier_shift[gate]), 32)

    def _accumulate(self, gate: int, unit: int, x: Sequence[int], recurrent: int) -> int:
        return add(self.bias[gate][unit], [*self.w_x[gate][unit], 1], [*x, recurrent], 32)

    def step(self, h_q30: list[int], x: Sequence[int], u_q31: int | None = None) -> list[int]:
        """Return the state after a step with inputs x; `u_q31` stands in for the update gate."""
        units = range(self.hidden)
        h_q15 = [copy(h) for h in h_q30]
        r_q31, update_q31 = [], []
        for unit in units:
            a_r = self._accumulate(R, unit, x, self._recur(R, unit, h_q15))
            a_u = self._accumulate(U, unit, x, self._recur(U, unit, h_q15))
            r_q31.append(sigmoid_q31(a_r >> self.shift[R]))
            update_q31.append(sigmoid_q31(a_u >> self.shift[U]) if u_q31 is None else u_q31)
        rh_q15 = [fit(round_shift(h * r, 46), 16) for h, r in zip(h_q30, r_q31, strict=True)]
        following = []
        for unit in units:
            if self.after:
                recurrent = self._recur(N, unit, h_q15)
                a_nh = add(self.bias[N_RECURRENT][unit], [1], [recurrent], 32)
                part = mul_high(a_nh, r_q31[unit])
            else:
                part = self._recur(N, unit, rh_q15)
            n_q30 = tanh_q30(self._accumulate(N, unit, x, part) >> self.shift[N])
            distance = fit(n_q30 - h_q30[unit], 32)
            h = fit(h_q30[unit] + 2 * mul_high(distance, update_q31[unit]), 32)
            assert abs(h) <= H_LIMIT_Q30
            following.append(h)
        return following


class Recurrent:
    """The nodes `gru` and `gru_stack`, streaming or over a window of features."""

    h_q30: list[list[int]]

    def __init__(self, node: Node) -> None:
        """Read the layers from the bottom up."""
        lower = node.get("lower", [])
        self.layers = [Gru(layer) for layer in [*lower, node["gru"]]]
        self.window: int = node["window"]
        self.samples: list[list[int]] = []
        self.reset()

    def reset(self) -> None:
        """Put every layer to zero."""
        self.h_q30 = [[0] * layer.hidden for layer in self.layers]

    def begin(self, features: list[int], *, settled: bool) -> None:
        """Put the window to rest at these features, or the state to its start or to its rest."""
        self.reset()
        self.samples = [features] * self.window
        if self.window or not settled:
            return
        x: Sequence[int] = features
        for index, layer in enumerate(self.layers):
            for _ in range(RELAX_STEPS):
                self.h_q30[index] = layer.step(self.h_q30[index], x, HALF_Q31)
            x = [copy(h) for h in self.h_q30[index]]

    def step(self, features: list[int]) -> list[int]:
        """Return h_q30 of the topmost layer."""
        if self.window:
            self.samples = [*self.samples[1:], features]
            self.reset()
        for sample in self.samples or [features]:
            x: Sequence[int] = sample
            for index, layer in enumerate(self.layers):
                self.h_q30[index] = layer.step(self.h_q30[index], x)
                x = [copy(h) for h in self.h_q30[index]]
        return self.h_q30[-1]


SATURATED, SLOWEST = 2**30, 15
IN, FORGET, CANDIDATE, OUT = range(4)


class Lstm:
    """One layer of section 3: weights, and a step from one state (h, c) to the next."""

    def __init__(self, lstm: Node) -> None:
        """Read the arrays of the model file."""
        self.bias = read_rows(lstm["bias"])
        self.w_x, self.w_h = read_gates(lstm["w_x"]), read_gates(lstm["w_h"])
        self.shift, self.multiplier_shift = lstm["shift"], lstm["multiplier_shift"]
        self.multiplier = lstm["multiplier"] and read_rows(lstm["multiplier"])
        self.bits, self.hidden = lstm["cell_bits"], len(self.w_h[0])
        assert 24 <= self.bits <= 27
        check_width(self.bias, 32)
        check_width(self.w_x, 16)
        check_width(self.w_h, 8 if self.multiplier else 16)

    def _read(self, gate: int, unit: int, x: Sequence[int], h_q15: Sequence[int]) -> int:
        recurrent = add(0, self.w_h[gate][unit], h_q15, 32)
        if self.multiplier:
            product = fit(self.multiplier[gate][unit] * recurrent, 64)
            recurrent = fit(round_shift(product, self.multiplier_shift[gate]), 32)
        total = add(self.bias[gate][unit], [*self.w_x[gate][unit], 1], [*x, recurrent], 32)
        return total >> self.shift[gate]

    def step(
        self, h_q30: Sequence[int], cell: Sequence[int], x: Sequence[int], relaxing: bool = False
    ) -> tuple[list[int], list[int]]:
        """Return h and c after a step with inputs x, in time or towards rest."""
        h_q15 = [copy(h) for h in h_q30]
        outputs, cells = [], []
        for unit, c in enumerate(cell):
            t = [self._read(gate, unit, x, h_q15) for gate in range(4)]
            added = mul_high(tanh_q30(t[CANDIDATE]), sigmoid_q31(t[IN]))
            added = fit(round_shift(added, 30 - self.bits), 32)
            if relaxing:
                forget = fit(2**31 - sigmoid_q31(t[FORGET]), 32)
                distance, doublings = fit(added - mul_high(c, forget), 32), 0
                while forget << doublings < 2**30:
                    doublings += 1
                assert doublings <= SLOWEST
                after = saturate(fit(c + (distance << doublings), 64), -SATURATED, SATURATED)
            else:
                moved = fit(mul_high(c, sigmoid_q31(t[FORGET])) + added, 32)
                after = 2 * saturate(moved, -SATURATED // 2, SATURATED // 2)
            fit(after + 2 ** (self.bits - 17), 32)
            bend = tanh_q30(round_shift(after, self.bits - 16))
            outputs.append(2 * mul_high(bend, sigmoid_q31(t[OUT])))
            cells.append(fit(after, 32))
            assert abs(outputs[-1]) <= H_LIMIT_Q30
        return outputs, cells


class RecurrentLstm(Recurrent):
    """The node `lstm`."""

    def __init__(self, node: Node) -> None:
        """Read the layers from the bottom up."""
        self.lstms = [Lstm(layer) for layer in node["layers"]]
        self.window: int = node["window"]
        self.samples: list[list[int]] = []
        self.reset()

    def reset(self) -> None:
        """Put every layer to zero."""
        self.h_q30 = [[0] * layer.hidden for layer in self.lstms]
        self.cells = [[0] * layer.hidden for layer in self.lstms]

    def begin(self, features: list[int], *, settled: bool) -> None:
        """Put the window to rest at these features, or the state to its start or to its rest."""
        self.reset()
        self.samples = [features] * self.window
        if not self.window and settled:
            self._walk(features, RELAX_STEPS, relaxing=True)

    def _walk(self, features: Sequence[int], times: int, relaxing: bool) -> None:
        x = features
        for k, layer in enumerate(self.lstms):
            for _ in range(times):
                self.h_q30[k], self.cells[k] = layer.step(self.h_q30[k], self.cells[k], x, relaxing)
            x = [copy(h) for h in self.h_q30[k]]

    def step(self, features: list[int]) -> list[int]:
        """Return h_q30 of the topmost layer."""
        if self.window:
            self.samples = [*self.samples[1:], features]
            self.reset()
        for sample in self.samples or [features]:
            self._walk(sample, 1, relaxing=False)
        return self.h_q30[-1]


class Join:
    """`join`: copies of layers, and features, side by side."""

    def __init__(self, node: Node) -> None:
        """Read what is copied."""
        self.shift, self.widths = node["shift"], node["widths"]

    def step(self, inputs: Sequence[Sequence[int]]) -> list[int]:
        """Return the copies."""
        found: list[int] = []
        for part, shift, width in zip(inputs, self.shift, self.widths, strict=True):
            assert shift in (0, 15) and len(part) == width
            found += [fit(copy(v) if shift else v, 16) for v in part]
        return found


class Dense:
    """`dense`, which reads copies, and `feature_dense`, which reads the features themselves."""

    def __init__(self, node: Node) -> None:
        """Read the arrays of the model file."""
        self.copies = node["kind"] == "dense"
        self.activation = node["activation"]
        self.bias, self.weights = read_vector(node["bias"]), read_rows(node["weights"])
        self.shift, self.low, self.high = node["shift"], node["low"], node["high"]
        check_width(self.bias, 32)
        check_width(self.weights, 16)

    def step(self, inputs: Sequence[int]) -> list[int]:
        """Return the int32 outputs y."""
        x = [copy(value) for value in inputs] if self.copies else inputs
        y = []
        for i, (bias, row) in enumerate(zip(self.bias, self.weights, strict=True)):
            a = add(bias, row, x, 32) >> self.shift[i]
            if self.activation == "tanh":
                y.append(tanh_q30(a))
            else:
                assert self.activation == "clip"
                y.append(fit(saturate(a, fit(self.low[i], 16), fit(self.high[i], 16)) << 15, 32))
        return y


class LayerNorm:
    """`layer_norm`."""

    def __init__(self, node: Node) -> None:
        """Read the rows of the model file."""
        self.align, self.shift, self.epsilon = node["align"], node["shift"], node["epsilon"]
        self.gain, self.bias = read_vector(node["gain"]), read_vector(node["bias"])
        assert 1 <= len(self.align) <= 128 and 1 <= self.epsilon <= 2**60
        check_width(self.gain, 32)
        check_width(self.bias, 32)

    def step(self, inputs: Sequence[int]) -> list[int]:
        """Return the int32 results y."""
        count, p = len(inputs), 27
        while 2 ** (p - 26) <= count:
            p += 1
        assert len(self.align) == count
        v = [round_shift(copy(y) * 4096, by) for y, by in zip(inputs, self.align, strict=True)]
        total = fit(sum(v), 64)
        reciprocal = (2 ** (p + 1) + count) // (2 * count)
        mean = round_shift(fit(total * reciprocal, 64), p)
        d = [fit(one - mean, 32) for one in v]
        w, doublings = self.epsilon + sum(one * one for one in d), 0
        assert w < 2**62
        for by in (32, 16, 8, 4, 2):
            if w < 2 ** (62 - by):
                w, doublings = w * 2**by, doublings + by
        a = w // 2**32
        assert 2**28 <= a < 2**30
        r = 1143535043 - 652298158 * a // 2**30
        for _ in range(4):
            r = r * (3 * 2**29 - r * r // 2**29 * a // 2**30) // 2**30
        scale = fit(r * isqrt(count * 2**52) // 2**29, 32)
        y = []
        for one, gain, shift, bias in zip(d, self.gain, self.shift, self.bias, strict=True):
            n = fit(round_shift(fit(one * scale, 64), 31 - doublings // 2), 32)
            y.append(fit(round_shift(fit(n * gain, 64), shift) + bias, 32))
        return y


class Head:
    """y_k of 4.4, and `join_head`, which reads copies as they are."""

    def __init__(self, node: Node) -> None:
        """Read the weights."""
        self.copies = node["kind"] == "head"
        self.weights = read_rows(node["weights"])
        check_width(self.weights, 16)

    def step(self, inputs: Sequence[int]) -> list[int]:
        """Return y."""
        x = [copy(value) for value in inputs] if self.copies else inputs
        return [add(0, row, x, 32) for row in self.weights]


class Drift:
    """drift_k of 4.4."""

    def __init__(self, node: Node) -> None:
        """Read the coefficients."""
        self.bias, self.coefficients = read_vector(node["bias"]), read_rows(node["coefficients"])
        self.head = read_vector(node["head_coefficients"]) if node["head"] else None
        self.shift, self.low, self.high = node["shift"], node["low"], node["high"]

    def step(self, phi: Sequence[int], y: Sequence[int]) -> tuple[list[int], bool]:
        """Return the drifts, and whether one of them was limited."""
        drifts, limited = [], False
        for k, row in enumerate(self.coefficients):
            weights, values = (
                (row, phi) if self.head is None else ([*row, self.head[k]], [*phi, y[k]])
            )
            free = add(self.bias[k], weights, values, 64) >> self.shift[k]
            drift = fit(saturate(free, self.low[k], self.high[k]), 32)
            limited = limited or drift != free
            drifts.append(drift)
        return drifts, limited
