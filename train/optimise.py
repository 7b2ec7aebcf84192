"""How networks are trained: the settings, the learning-rate cycle, and AdamW on many at once."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from zerodrift.base.errors import InputError
from zerodrift.train.networks import Network

Array32 = NDArray[np.float32]

CYCLE_START, CYCLE_END = 1 / 25, 1e-4
"""The learning rate begins and ends at these shares of its peak."""
GRADIENT_LIMIT = 1.0
"""Longest gradient; a longer one is shortened to this."""
BETAS, EPSILON = (0.9, 0.99), 1e-8
"""Of AdamW."""


class Stack:
    """The parameters of many networks of one kind as one array, and AdamW's steps on all of them.

    A network that sees fewer features than another has zeros for the missing weights, which stay
    zero since the features that they multiply are.
    """

    def __init__(self, networks: Sequence[Network], weight_decay: float, device: str) -> None:
        """Take the networks' parameters.

        Args:
            networks: of one kind; their parameters have the same names and numbers of axes.
            weight_decay: per step and unit of learning rate, on weights but not on biases.
            device: where the arrays go.
        """
        self._device = device
        parameters = [dict(network.named_parameters()) for network in networks]
        self._own = [{name: tuple(p.shape) for name, p in own.items()} for own in parameters]
        self._shapes = {
            name: tuple(np.max([own[name] for own in self._own], axis=0).tolist())
            for name in self._own[0]
        }
        sizes = [math.prod(shape) for shape in self._shapes.values()]
        begins = np.cumsum([0, *sizes]).tolist()
        self._places = {
            name: slice(begin, begin + size)
            for name, begin, size in zip(self._shapes, begins, sizes, strict=False)
        }
        self.flat = torch.zeros(len(networks), sum(sizes), device=device)
        """[A, P]."""
        self.gradient, self._first, self._second = (torch.zeros_like(self.flat) for _ in range(3))
        self._steps = torch.zeros(len(networks), 1, dtype=torch.float64, device=device)
        self._decays = torch.zeros(sum(sizes), device=device)
        for name, place in self._places.items():
            if "bias" not in name:
                self._decays[place] = weight_decay
        for i, own in enumerate(parameters):
            self._fill(self.flat, i, {k: p.detach().numpy() for k, p in own.items()})

    def _view(self, flat: Tensor, name: str) -> Tensor:
        return flat[:, self._places[name]].view(len(flat), *self._shapes[name])

    def _fill(self, flat: Tensor, i: int, values: Mapping[str, NDArray[np.float32]]) -> None:
        """Put one network's values by name in an array like `flat`."""
        for name, value in values.items():
            corner = tuple(slice(0, n) for n in value.shape)
            self._view(flat, name)[i][corner] = torch.from_numpy(value).to(self._device)

    def read(self) -> dict[str, Tensor]:
        """Return the parameters of all networks by name, [A, ...]."""
        return {name: self._view(self.flat, name) for name in self._shapes}

    def track(self, part: slice) -> dict[str, Tensor]:
        """Return the parameters of some networks as leaves that gradients are asked for."""
        return {name: p[part].detach().requires_grad_() for name, p in self.read().items()}

    def differentiate(self, loss: Tensor, part: slice, tracked: Mapping[str, Tensor]) -> None:
        """Put the gradient of some networks' losses in its place.

        Args:
            loss: sum of the losses, each of which depends on its own network alone.
            part: which networks.
            tracked: what `track` returned for them.
        """
        found = torch.autograd.grad(loss, list(tracked.values()))
        for name, gradient in zip(tracked, found, strict=True):
            self._view(self.gradient, name)[part] = gradient

    def step(self, rates: Sequence[float], moving: Sequence[bool]) -> None:
        """Take AdamW's step on every network that moves, gradients limited in length.

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

    def unstack(self, flat: Array32, i: int) -> dict[str, Array32]:
        """Return one network's parameters by name, from its row of an array like `flat`."""
        found = {}
        for name, own in self._own[i].items():
            corner = tuple(slice(0, n) for n in own)
            found[name] = flat[self._places[name]].reshape(self._shapes[name])[corner].copy()
        return found

    def export(self, i: int) -> dict[str, NDArray[np.generic]]:
        """Return one network's parameters and moments, for a checkpoint."""
        found: dict[str, NDArray[np.generic]] = {"step": self._steps[i].cpu().numpy()}
        kinds = {"weights": self.flat, "exp_avg": self._first, "exp_avg_sq": self._second}
        for kind, flat in kinds.items():
            own = self.unstack(flat[i].cpu().numpy(), i)
            found |= {f"{kind}.{name}": value for name, value in own.items()}
        return found

    def restore(self, i: int, stored: Mapping[str, NDArray[np.generic]]) -> None:
        """Take back what `export` returned."""
        self._steps[i] = float(stored["step"].item())
        kinds = {"weights": self.flat, "exp_avg": self._first, "exp_avg_sq": self._second}
        for kind, flat in kinds.items():
            self._fill(flat, i, {n: stored[f"{kind}.{n}"].astype(np.float32) for n in self._own[i]})


def one_cycle(place: float, warm_up: float) -> float:
    """Return the learning rate as a share of its peak: up by half a cosine, and down by another.

    Args:
        place: share of the training that is done, 0 .. 1.
        warm_up: share in which it rises.

    Source: Smith and Topin, "Super-convergence", 2018.
    """
    if place < warm_up:
        rise = 0.5 - 0.5 * math.cos(math.pi * place / warm_up)
        return CYCLE_START + (1.0 - CYCLE_START) * rise
    fall = 0.5 + 0.5 * math.cos(math.pi * (place - warm_up) / (1.0 - warm_up))
    return CYCLE_END + (1.0 - CYCLE_END) * fall


def draw_seed(seed: int, start: int) -> int:
    """Return the seed of one start, unrelated to those of its neighbours."""
    return int(
        np.random.SeedSequence((seed, start)).generate_state(1, np.uint64)[0] >> np.uint64(1)
    )


def explain_divergence(epoch: int, learning_rate: float) -> InputError:
    """Return the error of a training whose loss is no number any more."""
    return InputError(
        f"the training of the network diverged in epoch {epoch}; lower"
        f" [network] learning_rate (now {learning_rate:g}) or look at the logs' range."
    )
