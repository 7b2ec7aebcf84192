"""The recipe of training written down a second time: one network, PyTorch's autograd and AdamW.

It shares the networks' first weights and the draws of the order with the engine, and nothing else.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from zerodrift.train.attempts import Problem
from zerodrift.train.engine import Result, draw_seed, one_cycle
from zerodrift.train.networks import FeedForwardNetwork, GruNetwork, MlpNetwork, Network
from zerodrift.train.sequences import Sequence32


@dataclass(frozen=True)
class Cell:
    """Weights of a GRU, as `GruNetwork` has them too."""

    w_x: Tensor
    w_h: Tensor
    bias: Tensor
    reset: str


def step_gru(cell: Cell | GruNetwork, x: Tensor, h: Tensor, *, resting: bool = False) -> Tensor:
    """Return the next state [B, H] from features x [B, I], by PyTorch's own GRU.

    It keeps z = 1 - u. Resting moves by half of the distance. A reset before the product, which it
    lacks, enters as further features: r * h.
    """
    three, _, width = cell.w_h.shape
    w_x, w_h, bias = cell.w_x, cell.w_h, cell.bias
    if cell.reset == "before":
        r = torch.sigmoid(x @ w_x[0].T + h @ w_h[0].T + bias[0])
        x = torch.cat([x, r * h], 1)
        gates, candidate = w_h.split([2, 1])
        w_x = torch.cat([w_x, torch.cat([torch.zeros_like(gates), candidate])], 2)
        w_h = torch.cat([gates, torch.zeros_like(candidate)])
        bias = torch.cat([bias[:3], torch.zeros_like(bias[3:])])
    sign = x.new_tensor([1.0, 0.0 if resting else -1.0, 1.0])[:, None]
    w_x, w_h = (w.flatten(0, 1) * sign.repeat_interleave(width, 0) for w in (w_x, w_h))
    inside = torch.cat([x.new_zeros((three - 1) * width), bias[3]])
    return torch.gru_cell(x, h, w_x, w_h, (bias[:3] * sign).flatten(), inside)


def answer(network: Network, x: Tensor, h: Tensor) -> tuple[Tensor, Tensor]:
    """Return drift [T, B, K] and states [T, B, H] for features x [T, B, I], from state h."""
    if isinstance(network, GruNetwork):
        states = []
        for now in x:
            h = step_gru(network, now, h)
            states.append(h)
        walked = torch.stack(states)
        return walked @ network.head.T + network.head_bias, walked
    assert isinstance(network, FeedForwardNetwork)
    drift = torch.stack([answer_at_once(network, now) for now in x])
    return drift, x.new_zeros(*x.shape[:2], 0)


def answer_at_once(network: FeedForwardNetwork, x: Tensor) -> Tensor:
    """Return the outputs [B, K] of an MLP or a TCN for features x [B, I]."""
    if isinstance(network, MlpNetwork):
        for weight, bias in zip(network.weights, network.biases, strict=True):
            x = torch.tanh(nn.functional.linear(x, weight, bias))
        return nn.functional.linear(x, network.head, network.head_bias)
    x = x.reshape(len(x), network.window, network.channels).flip(1).transpose(1, 2)  # oldest first
    for weight, bias, dilation in zip(
        network.weights, network.biases, network.dilations, strict=True
    ):
        x = torch.relu(nn.functional.conv1d(x, weight, bias, dilation=dilation))
    return nn.functional.linear(x[:, :, -1], network.head, network.head_bias)


def rest(network: Network, x: Tensor) -> Tensor:
    """Return the state [B, H] at rest under features x [B, I]."""
    if not isinstance(network, GruNetwork):
        return x.new_zeros(len(x), 0)
    h = x.new_zeros(len(x), network.width)
    with torch.no_grad():
        for _ in range(64):
            h = step_gru(network, x, h, resting=True)
    return h


class Walk:
    """One run with a chunk at rest in front and behind, and the states along it."""

    def __init__(self, s: Sequence32, front: int, back: int) -> None:
        def pad(a: np.ndarray, first: np.ndarray, last: np.ndarray) -> Tensor:
            parts = [np.repeat(first[None], front, 0), a, np.repeat(last[None], back, 0)]
            return torch.from_numpy(np.concatenate(parts))

        nothing, one = np.zeros_like(s.target[0]), np.ones((len(s), 1), np.float32)
        self.group, self.length = s.group, len(s)
        self.x = pad(s.features, s.features[0], s.features[-1])
        self.target = pad(s.target, nothing, nothing)
        self.weight = pad(one, one[0] * 0, one[0] * 0)
        self.states = torch.empty(0)
        """[n + 1, H] before each sample and after the last."""


def train_alone(problem: Problem) -> Result:
    """Return what the engine returns for a problem, one start after the other."""
    found = [train_start(problem, start) for start in problem.settings.starts]
    return min(found, key=lambda result: result.rmse)


def train_start(problem: Problem, start: int) -> Result:
    """Return what becomes of one start."""
    s = problem.settings
    network = problem.build(torch.Generator().manual_seed(draw_seed(s.seed, start)))
    named = dict(network.named_parameters())
    decaying = [p for name, p in named.items() if "bias" not in name]
    others = [p for name, p in named.items() if "bias" in name]
    groups = [{"params": decaying, "weight_decay": s.weight_decay}]
    groups += [{"params": others, "weight_decay": 0.0}]
    optimiser = torch.optim.AdamW(groups, lr=s.learning_rate, betas=(0.9, 0.99))
    front = s.chunk if s.memory == "stream" else int(s.memory) - 1
    walks = [Walk(x, front, s.chunk) for x in problem.sequences]
    offsets = {w.group: torch.zeros(walks[0].target.shape[1]) for w in walks}
    with torch.no_grad():
        for w in walks:
            _, after = answer(network, w.x[front:, None], rest(network, w.x[:1]))
            w.states = torch.cat([after[:1, 0]] * (front + 1) + [after[:, 0]])
    best = {name: p.detach().numpy().copy() for name, p in named.items()}
    without = least = last = measure(network, problem)
    at = 0
    for epoch in range(s.epochs):
        rng = np.random.default_rng((s.seed, start, epoch))
        if s.memory == "stream":
            for w in walks:
                w.states[: front + 1] = rest(network, w.x[:1])
            first = int(rng.integers(1, s.chunk + 1))
            span = s.chunk
            places = [(w, t) for w in walks for t in range(first, s.chunk + w.length, s.chunk)]
        else:
            span = int(s.memory)
            places = [(w, t) for w in walks for t in range(w.length)]
        order, batches = rng.permutation(len(places)), problem.count_batches()
        error_of = {group: 0.0 * value for group, value in offsets.items()}
        count_of = dict.fromkeys(offsets, 0.0)
        squares = counted = 0.0
        for number, part in enumerate(np.array_split(order, batches)):
            rate = s.learning_rate * one_cycle((epoch + number / batches) / s.epochs, s.warm_up)
            for group in optimiser.param_groups:
                group["lr"] = rate
            chosen = [places[i] for i in part]
            x, target, weight = (
                torch.stack([getattr(w, name)[t : t + span] for w, t in chosen], dim=1)
                for name in ("x", "target", "weight")
            )
            state = network.cold(len(chosen)).T
            if s.memory == "stream":
                state = torch.stack([w.states[t] for w, t in chosen])
            drift, states = answer(network, x, state)
            if s.memory == "stream":
                for j, (w, t) in enumerate(chosen):
                    w.states[t + 1 : t + 1 + span] = states[:, j].detach()
            else:
                drift, target, weight = drift[-1:], target[-1:], weight[-1:]
            own = torch.stack([offsets[w.group] for w, _ in chosen])
            error = (drift + own - target) * weight
            total = float(weight.sum()) * error.shape[2]
            loss = error.square().sum() / total
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            squares, counted = squares + loss.item() * total, counted + total
            for j, (w, _) in enumerate(chosen):
                error_of[w.group] += error[:, j].sum(0).detach()
                count_of[w.group] += float(weight[:, j].sum())
        if problem.tared:
            moved = {g: o - error_of[g] / max(count_of[g], 1.0) for g, o in offsets.items()}
            mean = torch.stack(list(moved.values())).mean(0)
            offsets = {g: o - mean for g, o in moved.items()}
        if (epoch + 1) % max(1, s.epochs // s.evaluations) == 0 or epoch + 1 == s.epochs:
            last = measure(network, problem) if problem.held_out else math.sqrt(squares / counted)
            if last < least or not problem.held_out:
                least, at = last, epoch + 1
                best = {name: p.detach().numpy().copy() for name, p in named.items()}
    return Result(best, start, at, least, last, without)


def measure(network: Network, problem: Problem) -> float:
    """Return the RMSE on the held-out runs."""
    if not problem.held_out:
        return math.inf
    errors: dict[str, list[np.ndarray]] = {}
    for s in problem.held_out:
        x = torch.from_numpy(s.features)[:, None]
        with torch.no_grad():
            if problem.settings.memory == "stream":
                drift, _ = answer(network, x, rest(network, x[0]))
            else:
                memory = int(problem.settings.memory)
                x = torch.cat([x[:1]] * (memory - 1) + [x])
                windows = torch.cat([x[t : t + memory] for t in range(len(s))], dim=1)
                drift = answer(network, windows, network.cold(len(s)).T)[0][-1][:, None]
        error = (s.target - drift[:, 0].numpy())[s.skip :].astype(np.float64)
        errors.setdefault(s.group, []).append(error)
    parts = [np.concatenate(found) for found in errors.values()]
    rest_of = [e - e.mean(axis=0) if problem.tared else e for e in parts]
    return float(np.sqrt(np.mean(np.concatenate(rest_of) ** 2)))
