"""The parameters of many networks in one array, and the steps of AdamW on all of them at once."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.train.batch_recurrence import BatchWeights
from zerodrift.train.networks import GruNetwork
from zerodrift.train.optimise import GRADIENT_LIMIT

BETAS, EPSILON = (0.9, 0.99), 1e-8
"""Of AdamW, as `Trainer` sets them."""
NAMES = ("w_x", "w_h", "bias", "head", "head_bias")


class StackedWeights:
    """All parameters as one array `flat` [A, P], with their `gradient` [A, P]."""

    def __init__(
        self, networks: Sequence[GruNetwork], width: int, weight_decay: float, device: str
    ) -> None:
        """Take the networks' parameters.

        Args:
            networks: of one shape but for their features.
            width: most features of any; the others' weights are zero.
            weight_decay: per step and unit of learning rate, on weights but not on biases.
            device: where the arrays go.
        """
        self._reset, self._device = networks[0].reset, device
        hidden, outputs = networks[0].w_h.shape[1], networks[0].head.shape[0]
        shapes = ((3, hidden, width), (3, hidden, hidden), (4, hidden), (outputs, hidden))
        self.shapes = dict(zip(NAMES, (*shapes, (outputs,)), strict=True))
        sizes = [math.prod(shape) for shape in self.shapes.values()]
        self._places = dict(zip(NAMES, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
        flat = torch.zeros(len(networks), sum(sizes))
        decays = torch.zeros(sum(sizes))
        for name, shape in self.shapes.items():
            place, size = self._places[name], math.prod(shape)
            part = flat[:, place : place + size].view(len(networks), *shape)
            for i, network in enumerate(networks):
                value = getattr(network, name).detach()
                if name == "w_x":
                    part[i, ..., : value.shape[2]] = value
                else:
                    part[i] = value
            if "bias" not in name:
                decays[place : place + size] = weight_decay
        self.flat, self._decays = flat.to(self._device), decays.to(self._device)
        self.gradient = torch.zeros_like(self.flat)
        self._first, self._second = torch.zeros_like(self.flat), torch.zeros_like(self.flat)
        self._steps = torch.zeros(len(networks), 1, dtype=torch.float64, device=self._device)

    def view(self, flat: Tensor, name: str) -> Tensor:
        """Return one kind of parameter [A, ...] in an array like `flat`."""
        shape, place = self.shapes[name], self._places[name]
        return flat[:, place : place + math.prod(shape)].view(len(flat), *shape)

    def read(self) -> BatchWeights:
        """Return the weights as the recurrence takes them."""
        parts = {name: self.view(self.flat, name) for name in NAMES}
        for name in ("w_x", "w_h"):
            parts[name] = parts[name].flatten(1, 2).contiguous()
        return BatchWeights(**parts, reset=self._reset)

    def step(self, rates: Sequence[float], moving: Sequence[bool]) -> None:
        """Take AdamW's step on every attempt that moves, gradients limited in length.

        Source: Loshchilov and Hutter, "Decoupled weight decay regularization", 2019.
        """
        gradient = self.gradient
        norm = gradient.norm(dim=1, keepdim=True)
        gradient *= (GRADIENT_LIMIT / (norm + 1e-6)).clamp(max=1.0)
        moves = torch.tensor(moving, device=self._device)[:, None]
        before = None
        if not all(moving):
            before = [t.clone() for t in (self.flat, self._first, self._second)]
        self._steps += moves
        rate = torch.tensor(rates, dtype=torch.float64, device=self._device)[:, None]
        self.flat *= 1.0 - rate.float() * self._decays
        self._first.lerp_(gradient, 1.0 - BETAS[0])
        self._second.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1.0 - BETAS[1])
        first = 1.0 - BETAS[0] ** self._steps.clamp(min=1.0)
        second = (1.0 - BETAS[1] ** self._steps.clamp(min=1.0)).sqrt()
        denominator = self._second.sqrt() / second.float() + EPSILON
        self.flat -= (rate / first).float() * (self._first / denominator)
        if before is not None:
            for now, then in zip((self.flat, self._first, self._second), before, strict=True):
                now.copy_(torch.where(moves, now, then))

    def unstack(self, flat: NDArray[np.float32], features: int) -> dict[str, NDArray[np.float32]]:
        """Return one network's parameters [P] by name, as `Trainer` does."""
        found: dict[str, NDArray[np.float32]] = {}
        for name, shape in self.shapes.items():
            place = self._places[name]
            value = flat[place : place + math.prod(shape)].reshape(shape)
            found[name] = (value[..., :features] if name == "w_x" else value).copy()
        return found
