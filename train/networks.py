"""The networks that learn the residual of the physical model: features in, drift at unit scale out.

A network carries a state from sample to sample, or is run afresh over the last `memory` samples;
that is the business of whoever calls it (`zerodrift.train.courses`). Arrays run
[time, channel, sequence]; of many networks at once, [time, network, channel, sequence].
"""

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from zerodrift.base.arrays import Array
from zerodrift.base.config import CONSTRAINTS, NetworkConfig
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.gru.cell import FloatGru
from zerodrift.operations.lstm.cell import FloatLstm
from zerodrift.train.contraction import (
    contract,
    contract_lstm,
    limit_head,
    round_weights,
    trim_weights,
)
from zerodrift.train.recurrence import (
    GruWeights,
    LstmWeights,
    run_gru,
    run_lstm,
    settle,
    settle_lstm,
)

Parameters = Mapping[str, Tensor]
"""Those of S networks of one kind by name, each [S, ...]."""

FORMS = {"reset_after": "after", "reset_before": "before"}
"""`[network] form` -> where the reset gate acts, in the words of `zerodrift.operations.gru`."""
MLP_LAYERS = 3
LONGEST_START_STEPS = 10.0
"""Units start with time constants from one step to this many; slower ones come from the lags."""


class Network(ABC, torch.nn.Module):
    """What every kind of network offers to training and export."""

    state_type = torch.float32
    """Of the states."""
    contracting = limited = False
    """See `[network]`; recurrent networks may be."""

    @property
    @abstractmethod
    def width(self) -> int:
        """Width H of the state; 0 for a network without one."""

    @abstractmethod
    def run_many(self, parameters: Parameters, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the drift [T, S, K, B] and the states [T, S, H, B] of S networks of this kind.

        Args:
            parameters: of the S networks; this network's own are not read.
            x: [T, S, I, B] features.
            state: [S, H, B] before the first sample.
        """

    @abstractmethod
    def rest_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return the states [S, H, B] of S networks at rest under constant features x [S, I, B].

        Args:
            parameters: of the S networks; this network's own are not read.
            x: features.
        """

    def constrain_many(self, parameters: Parameters, reach: Tensor, swing: Tensor) -> None:
        """Bring the parameters of S networks to what is allowed, in place.

        Args:
            parameters: of the S networks; this network's own are not read.
            reach: [S, I] largest absolute value of each feature.
            swing: [S, K] half the distance of the lowest and highest target of each output.
        """
        if self.limited:
            limit_head(parameters["head"], swing)

    def _alone(self) -> Parameters:
        return {name: p[None] for name, p in self.named_parameters()}

    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the drift [T, K, B] and the states [T, H, B] for features x [T, I, B].

        Args:
            x: features.
            state: [H, B] before the first sample.
        """
        drift, states = self.run_many(self._alone(), x[:, None], state[None])
        return drift[:, 0], states[:, 0]

    def rest(self, x: Tensor) -> Tensor:
        """Return the state [H, B] of a sensor at rest under constant features x [I, B]."""
        with torch.no_grad():
            return self.rest_many(self._alone(), x[None])[0]

    def cold(self, batch: int) -> Tensor:
        """Return the state [H, B] that a window starts from."""
        return torch.zeros(self.width, batch, dtype=self.state_type)


class GruNetwork(Network):
    """A gated recurrent unit and a linear head."""

    def __init__(
        self,
        features: int,
        hidden: int,
        outputs: int,
        form: str,
        *,
        contracting: bool = False,
        limited: bool = False,
    ) -> None:
        super().__init__()
        self.reset = FORMS[form]
        self.contracting, self.limited = contracting, limited
        self.w_x = torch.nn.Parameter(torch.zeros(3, hidden, features))
        self.w_h = torch.nn.Parameter(torch.zeros(3, hidden, hidden))
        self.bias = torch.nn.Parameter(torch.zeros(4, hidden))
        self.head = torch.nn.Parameter(torch.zeros(outputs, hidden))
        self.head_bias = torch.nn.Parameter(torch.zeros(outputs))

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the first weights; the head is zero, so that training starts at physics alone.

        The update gates start with time constants spread evenly in the logarithm, one of the few
        things known beforehand about thermal memory.
        Source: Tallec and Ollivier, "Can recurrent neural networks warp time?", 2018.
        """
        hidden, features = self.w_x.shape[1:]
        with torch.no_grad():
            for weights, fan_in in ((self.w_x, features), (self.w_h, hidden)):
                weights.uniform_(-1.0, 1.0, generator=generator).div_(math.sqrt(fan_in))
            share = torch.rand(hidden, generator=generator)
            steps = torch.exp(share * math.log(LONGEST_START_STEPS))
            self.bias.zero_()
            self.bias[1] = -torch.log(steps - 1.0 + 0.02)

    @property
    def width(self) -> int:
        """Number of hidden units H."""
        return int(self.w_h.shape[1])

    def _gather(self, parameters: Parameters) -> GruWeights:
        w_x, w_h = (parameters[name].flatten(1, 2).contiguous() for name in ("w_x", "w_h"))
        return GruWeights(w_x, w_h, parameters["bias"], self.reset)

    def run_many(self, parameters: Parameters, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return drift and states of S GRUs; see `Network`."""
        states = run_gru(x, state, self._gather(parameters))
        drift = torch.matmul(parameters["head"], states) + parameters["head_bias"][..., None]
        return drift, states

    def constrain_many(self, parameters: Parameters, reach: Tensor, swing: Tensor) -> None:
        """Shrink recurrent weights until an error of the state shrinks, if that is asked for."""
        super().constrain_many(parameters, reach, swing)
        if self.contracting:
            w_x, w_h, bias = (parameters[name] for name in ("w_x", "w_h", "bias"))
            contract(w_x, w_h, bias, self.reset, reach)

    def rest_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return the states at rest [S, H, B], by the relaxation that the chip's `settle` does."""
        return settle(x, self._gather(parameters))

    def to_float(self) -> FloatGru:
        """Return the recurrence's weights in the form that simulation and export use."""
        w_x, w_h, bias = (read_array(w) for w in (self.w_x, self.w_h, self.bias))
        if self.contracting:
            w_h = round_weights(w_h)
        if self.reset == "before":
            bias[3] = 0.0
        return FloatGru(w_x=w_x, w_h=w_h, bias=bias, reset=self.reset)


class LstmNetwork(Network):
    """A long short-term memory and a linear head; the state is h beside c."""

    def __init__(
        self,
        features: int,
        hidden: int,
        outputs: int,
        *,
        contracting: bool = False,
        limited: bool = False,
    ) -> None:
        super().__init__()
        self.contracting, self.limited = contracting, limited
        self.w_x = torch.nn.Parameter(torch.zeros(4, hidden, features))
        self.w_h = torch.nn.Parameter(torch.zeros(4, hidden, hidden))
        self.bias = torch.nn.Parameter(torch.zeros(4, hidden))
        self.head = torch.nn.Parameter(torch.zeros(outputs, hidden))
        self.head_bias = torch.nn.Parameter(torch.zeros(outputs))

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the first weights as `GruNetwork.initialise` does.

        The input gate starts as what the forget gate leaves, so that c is a weighted mean.
        Source: Tallec and Ollivier, "Can recurrent neural networks warp time?", 2018.
        """
        hidden, features = self.w_x.shape[1:]
        with torch.no_grad():
            for weights, fan_in in ((self.w_x, features), (self.w_h, hidden)):
                weights.uniform_(-1.0, 1.0, generator=generator).div_(math.sqrt(fan_in))
            share = torch.rand(hidden, generator=generator)
            steps = torch.exp(share * math.log(LONGEST_START_STEPS))
            self.bias.zero_()
            self.bias[1] = torch.log(steps - 1.0 + 0.02)
            self.bias[0] = -self.bias[1]

    @property
    def width(self) -> int:
        """Width of the state, twice the hidden units."""
        return 2 * int(self.w_h.shape[1])

    def _gather(self, parameters: Parameters) -> LstmWeights:
        w_x, w_h = (parameters[name].flatten(1, 2).contiguous() for name in ("w_x", "w_h"))
        return LstmWeights(w_x, w_h, parameters["bias"])

    def run_many(self, parameters: Parameters, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return drift and states of S LSTMs; see `Network`."""
        states = run_lstm(x, state, self._gather(parameters))
        shown = states[:, :, : self.width // 2]
        drift = torch.matmul(parameters["head"], shown) + parameters["head_bias"][..., None]
        return drift, states

    def constrain_many(self, parameters: Parameters, reach: Tensor, swing: Tensor) -> None:
        """Shrink weights until an error of the state shrinks, if that is asked for."""
        super().constrain_many(parameters, reach, swing)
        if self.contracting:
            w_x, w_h, bias = (parameters[name] for name in ("w_x", "w_h", "bias"))
            contract_lstm(w_x, w_h, bias, reach)

    def rest_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return the states at rest [S, 2 H, B], by the relaxation of the chip's `settle`."""
        return settle_lstm(x, self._gather(parameters))

    def to_float(self) -> FloatLstm:
        """Return the recurrence's weights in the form that simulation and export use."""
        w_x, w_h, bias = (read_array(w) for w in (self.w_x, self.w_h, self.bias))
        return FloatLstm(w_x, trim_weights(w_h) if self.contracting else w_h, bias)


class FeedForwardNetwork(Network):
    """A network without a state: its memory is in what it sees, windows or lags."""

    @abstractmethod
    def answer_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return the outputs [S, K, N] of S networks of this kind for features x [S, I, N]."""

    @abstractmethod
    def to_dense(self) -> tuple[FloatDense, ...]:
        """Return the layers before the head, all of them dense, as simulation and chip run them."""

    def answer(self, x: Tensor) -> Tensor:
        """Return the outputs [N, K] for features x [N, I]."""
        return self.answer_many(self._alone(), x.T[None])[0].T

    @property
    def width(self) -> int:
        """No state."""
        return 0

    def run_many(self, parameters: Parameters, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the drift [T, S, K, B], and states of no width; see `Network`."""
        steps, count, features, batch = x.shape
        found = self.answer_many(
            parameters, x.permute(1, 2, 0, 3).reshape(count, features, steps * batch)
        )
        drift = found.view(count, -1, steps, batch).permute(2, 0, 1, 3)
        return drift, x.new_zeros(steps, count, 0, batch)

    def rest_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return a state of no width, [S, 0, B]."""
        return x.new_zeros(x.shape[0], 0, x.shape[2])


def _apply_linear(weight: Tensor, bias: Tensor, x: Tensor) -> Tensor:
    """Return weight [S, M, N] times x [S, N, B] plus bias [S, M]."""
    return torch.baddbmm(bias[..., None], weight, x)


class MlpNetwork(FeedForwardNetwork):
    """Layers of tanh units, and a linear head."""

    def __init__(self, features: int, hidden: int, outputs: int, layers: int = MLP_LAYERS) -> None:
        super().__init__()
        widths = [features, *[hidden] * layers]
        self.weights = torch.nn.ParameterList(
            torch.zeros(b, a) for a, b in itertools.pairwise(widths)
        )
        self.biases = torch.nn.ParameterList(torch.zeros(b) for b in widths[1:])
        self.head = torch.nn.Parameter(torch.zeros(outputs, hidden))
        self.head_bias = torch.nn.Parameter(torch.zeros(outputs))

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the first weights (Glorot and Bengio, 2010); the head is zero."""
        with torch.no_grad():
            for weight, bias in zip(self.weights, self.biases, strict=True):
                reach = math.sqrt(6.0 / sum(weight.shape))
                weight.uniform_(-reach, reach, generator=generator)
                bias.uniform_(-0.5, 0.5, generator=generator)

    def answer_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return the outputs [S, K, N]; see `FeedForwardNetwork`."""
        for i in range(len(self.weights)):
            x = torch.tanh(_apply_linear(parameters[f"weights.{i}"], parameters[f"biases.{i}"], x))
        return _apply_linear(parameters["head"], parameters["head_bias"], x)

    def to_dense(self) -> tuple[FloatDense, ...]:
        """Return the hidden layers; see `FeedForwardNetwork`."""
        return tuple(
            FloatDense(read_array(weight), read_array(bias), "tanh")
            for weight, bias in zip(self.weights, self.biases, strict=True)
        )


class TcnNetwork(FeedForwardNetwork):
    """Causal convolutions of two taps, dilated 1, 2, 4, ..., over a window, and a linear head.

    The last dilation is shortened so that the answer sees the window exactly. Features are laid out
    newest sample first: feature `age * channels + channel`.

    Source: Bai, Kolter and Koltun, "An empirical evaluation of generic convolutional and recurrent
    networks for sequence modeling", 2018; here without residual branches.
    """

    def __init__(self, features: int, hidden: int, outputs: int, window: int) -> None:
        super().__init__()
        self.window = window
        self.channels = features // window
        self.dilations = list_dilations(window)
        widths = [self.channels, *[hidden] * len(self.dilations)]
        self.weights = torch.nn.ParameterList(
            torch.zeros(b, a, 2) for a, b in itertools.pairwise(widths)
        )
        self.biases = torch.nn.ParameterList(torch.zeros(b) for b in widths[1:])
        self.head = torch.nn.Parameter(torch.zeros(outputs, hidden))
        self.head_bias = torch.nn.Parameter(torch.zeros(outputs))

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the first weights (He et al., 2015); the head is zero."""
        with torch.no_grad():
            for weight, bias in zip(self.weights, self.biases, strict=True):
                reach = math.sqrt(6.0 / (weight.shape[1] * weight.shape[2]))
                weight.uniform_(-reach, reach, generator=generator)
                bias.uniform_(-0.5, 0.5, generator=generator)

    def answer_many(self, parameters: Parameters, x: Tensor) -> Tensor:
        """Return the outputs [S, K, N]; see `FeedForwardNetwork`."""
        count, _, batch = x.shape
        # [S, window, channels, N], newest sample first, becomes [S, channels, window, N].
        x = x.view(count, self.window, self.channels, batch).transpose(1, 2)
        for i, dilation in enumerate(self.dilations):
            weight, bias = parameters[f"weights.{i}"], parameters[f"biases.{i}"]
            ages = x.shape[2] - dilation
            taps = torch.cat((x[:, :, dilation:], x[:, :, :ages]), dim=1).flatten(2)
            found = _apply_linear(weight.transpose(2, 3).flatten(2), bias, taps)
            x = torch.relu(found).view(count, -1, ages, batch)
        return _apply_linear(parameters["head"], parameters["head_bias"], x[:, :, 0])

    def to_dense(self) -> tuple[FloatDense, ...]:
        """Return the convolutions at those ages that the answer needs, as dense layers."""
        ages = [0]
        layers: list[FloatDense] = []
        pairs = list(zip(self.weights, self.biases, self.dilations, strict=True))
        for depth, (weight, bias, dilation) in reversed(list(enumerate(pairs))):
            below = sorted({age + shift for age in ages for shift in (0, dilation)})
            if depth == 0:
                below = list(range(self.window))
            w, b = read_array(weight), read_array(bias)
            outputs, inputs = w.shape[:2]
            dense = np.zeros((len(ages) * outputs, len(below) * inputs))
            for row, age in enumerate(ages):
                rows = slice(row * outputs, (row + 1) * outputs)
                for tap, shift in enumerate((dilation, 0)):  # conv1d's taps, the older one first
                    at = below.index(age + shift) * inputs
                    dense[rows, at : at + inputs] = w[:, :, tap]
            layers.append(FloatDense(dense, np.tile(b, len(ages)), "clip", low=0.0))
            ages = below
        return tuple(reversed(layers))


def read_array(x: Tensor) -> Array:
    """Return a tensor's values in float64."""
    return np.asarray(x.detach().numpy().astype(np.float64))


def list_dilations(window: int) -> tuple[int, ...]:
    """Return 1, 2, 4, ... for two-tap convolutions that together see `window` samples.

    Example:
        >>> list_dilations(10)
        (1, 2, 4, 2)
    """
    dilations: list[int] = []
    left = window - 1
    while left > 0:
        dilations.append(min(2 ** len(dilations), left))
        left -= dilations[-1]
    return tuple(dilations)


def build_network(
    config: NetworkConfig, features: int, outputs: int, generator: torch.Generator
) -> GruNetwork | LstmNetwork | MlpNetwork | TcnNetwork:
    """Return the untrained network of a project, its weights drawn from `generator`."""
    network: GruNetwork | LstmNetwork | MlpNetwork | TcnNetwork
    asked = {key: True for key in CONSTRAINTS if config.options.get(key)}
    match config.kind:
        case "gru":
            form = str(config.options.get("form", "reset_after"))
            network = GruNetwork(features, config.hidden, outputs, form, **asked)
        case "lstm":
            network = LstmNetwork(features, config.hidden, outputs, **asked)
        case "tcn":
            network = TcnNetwork(features, config.hidden, outputs, int(config.memory))
        case _:
            network = MlpNetwork(features, config.hidden, outputs)
    network.initialise(generator)
    return network


def check_network(network: NetworkConfig, width: int, outputs: int) -> None:
    """Raise where a network's settings are out of range.

    Raises:
        InputError: says which.
    """
    build_network(network, width, outputs, torch.Generator())
