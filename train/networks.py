"""The networks that learn what physics leaves: features in, drift at unit scale out.

A network carries a state from sample to sample, or is run afresh over the last `memory` samples;
that is the business of whoever calls it (`zerodrift.train.sequences`). Arrays run
[time, channel, sequence].
"""

import math
from abc import ABC, abstractmethod

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.config import NetworkConfig
from zerodrift.errors import InputError
from zerodrift.operations.gru import FloatGru
from zerodrift.train.recurrence import GruWeights, run_gru

Array = NDArray[np.float64]

FORMS = {"reset_after": "after", "reset_before": "before"}
"""`[network] form` -> where the reset gate acts, in the words of `zerodrift.operations.gru`."""
LONGEST_START_STEPS = 10.0
"""Units start with time constants from one step to this many; slower ones come from the lags."""


class Network(ABC, torch.nn.Module):
    """What every kind of network offers to training and export."""

    @abstractmethod
    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the drift [T, K, B] and the states [T, H, B] for features x [T, I, B].

        Args:
            x: features.
            state: [H, B] before the first sample.
        """

    @abstractmethod
    def rest(self, x: Tensor) -> Tensor:
        """Return the state [H, B] of a sensor at rest under constant features x [I, B]."""

    @abstractmethod
    def cold(self, batch: int) -> Tensor:
        """Return the state [H, B] that a window starts from."""


class GruNetwork(Network):
    """A gated recurrent unit and a linear head."""

    def __init__(self, features: int, hidden: int, outputs: int, form: str) -> None:
        super().__init__()
        self.reset = FORMS[form]
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
    def weights(self) -> GruWeights:
        """The recurrence's weights."""
        return GruWeights(self.w_x, self.w_h, self.bias)

    def forward(self, x: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Return the drift [T, K, B] and the states [T, H, B]; see `Network`."""
        states = run_gru(x, state, self.weights, self.reset)
        return torch.matmul(self.head, states) + self.head_bias[:, None], states

    def rest(self, x: Tensor) -> Tensor:
        """Return the state at rest [H, B], by the relaxation that the chip's `settle` does."""
        resting = self.to_float().settle(x.numpy().T.astype(np.float64))
        return torch.from_numpy(np.ascontiguousarray(resting.T.astype(np.float32)))

    def cold(self, batch: int) -> Tensor:
        """Return zeros [H, B]."""
        return torch.zeros(self.w_h.shape[1], batch)

    def to_float(self) -> FloatGru:
        """Return the recurrence's weights in the form that simulation and export use."""
        w_x, w_h, bias = (w.detach().numpy().astype(np.float64) for w in self.weights)
        if self.reset == "before":
            bias[3] = 0.0
        return FloatGru(w_x=w_x, w_h=w_h, bias=bias, reset=self.reset)


def build_network(
    config: NetworkConfig, features: int, outputs: int, generator: torch.Generator
) -> GruNetwork:
    """Return the untrained network of a project, its weights drawn from `generator`.

    Raises:
        InputError: the kind cannot be trained by this version.
    """
    if config.kind != "gru":
        raise InputError(
            f"[network] kind '{config.kind}' cannot be trained by this version; use 'gru', or"
            " 'none' for physics alone."
        )
    form = str(config.options.get("form", "reset_after"))
    network = GruNetwork(features, config.hidden, outputs, form)
    network.initialise(generator)
    return network
