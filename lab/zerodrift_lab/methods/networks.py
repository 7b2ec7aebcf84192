"""The networks of the paper on its own inputs, by its own recipe or by a quicker schedule."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Run
from zerodrift.train.engine import GRADIENT_LIMIT, one_cycle
from zerodrift.train.networks import (
    FeedForwardNetwork,
    GruNetwork,
    MlpNetwork,
    Network,
    TcnNetwork,
)
from zerodrift_lab.methods.interface import (
    RECIPE,
    SCHEDULES,
    Fit,
    Fitted,
    FittedFunction,
    Options,
)
from zerodrift_lab.methods.windows import Windows, fit_windows

HIDDEN, WINDOW = 36, 10
"""Of the paper's MLP and its sequences; its GRU's size is not given, and taken to be the same."""
TCN_CHANNELS = 16
"""The paper does not give its TCN's size either; on the chip its convolutions are unrolled."""
AT_ONCE = 8192
"""Windows that are predicted together."""


@dataclass(frozen=True)
class Schedule:
    """How the weights are found."""

    epochs: int
    batch: int
    rate: float
    cycle: bool
    """One learning-rate cycle; else a constant rate."""


SCHEDULE = {
    RECIPE: Schedule(epochs=2000, batch=128, rate=1e-3, cycle=False),
    "quick": Schedule(epochs=40, batch=256, rate=1e-2, cycle=True),
}
WARM_UP = 0.25

Build = Callable[[int, int], Network]
"""(channels of a sample, outputs) -> untrained network, drawn from PyTorch's seed."""


def build_mlp(channels: int, outputs: int) -> Network:
    """Return the paper's MLP over whatever it is shown."""
    network = MlpNetwork(channels, HIDDEN, outputs)
    _draw(network, torch.Generator().manual_seed(torch.initial_seed()))
    return network


def build_tcn(channels: int, outputs: int) -> Network:
    """Return a TCN over ten samples."""
    network = TcnNetwork(channels, TCN_CHANNELS, outputs, WINDOW)
    _draw(network, torch.Generator().manual_seed(torch.initial_seed()))
    return network


def make_gru(form: str) -> Build:
    """Return the builder of a GRU with the reset gate before or after the recurrent product."""

    def build(channels: int, outputs: int) -> Network:
        network = GruNetwork(channels, HIDDEN, outputs, form)
        generator = torch.Generator().manual_seed(torch.initial_seed())
        reach = HIDDEN**-0.5  # PyTorch's own start
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.uniform_(-reach, reach, generator=generator)
        return network

    return build


def _draw(network: MlpNetwork | TcnNetwork, generator: torch.Generator) -> None:
    """Draw the first weights as PyTorch does for linear layers, the head's too."""
    with torch.no_grad():
        pairs = zip(
            [*network.weights, network.head], [*network.biases, network.head_bias], strict=True
        )
        for weight, bias in pairs:
            reach = float(weight[0].numel()) ** -0.5
            weight.uniform_(-reach, reach, generator=generator)
            bias.uniform_(-reach, reach, generator=generator)


def make_network(build: Build, length: int, recurrent: bool) -> Fit:
    """Return the fit of a network to windows.

    Args:
        build: makes the network.
        length: samples of a window; 1 for the present one alone.
        recurrent: the window is walked through in time; else it is seen at once.
    """

    def fit(runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
        if options.schedule not in SCHEDULES:
            raise InputError(
                f"no schedule '{options.schedule}'; expected one of {', '.join(SCHEDULES)}."
            )
        begin = time.process_time()
        torch.set_num_threads(1)
        windows = fit_windows(runs, options.thermometers, length, options.spacing_s)
        drift = np.concatenate([run.drift for run in runs])
        centre, spread = drift.mean(axis=0), drift.std(axis=0)
        spread = np.where(spread > 0.0, spread, 1.0)
        x = torch.cat([_arrange(windows, run, recurrent) for run in runs], dim=2)
        y = torch.from_numpy(((drift - centre) / spread).T.astype(np.float32))
        torch.manual_seed(seed)
        network = build(x.shape[1], y.shape[0])

        def conclude(seconds: float) -> Fitted:
            return _conclude(network, windows, recurrent, centre, spread, seconds)

        seconds = time.process_time() - begin
        seconds += _train(network, x, y, seed, options, lambda s: conclude(seconds + s))
        return conclude(seconds)

    return fit


def _arrange(windows: Windows, run: Run, recurrent: bool) -> torch.Tensor:
    """Return the windows [T, I, n]: T samples in time, or one row of all of them, newest first."""
    cut = windows.cut(run).astype(np.float32)  # [n, length, S]
    if recurrent:
        return torch.from_numpy(np.ascontiguousarray(cut[:, ::-1].transpose(1, 2, 0)))
    flat = cut.reshape(len(cut), -1)
    return torch.from_numpy(np.ascontiguousarray(flat.T[None]))


def _train(
    network: Network,
    x: torch.Tensor,
    y: torch.Tensor,
    seed: int,
    options: Options,
    conclude: Callable[[float], Fitted],
) -> float:
    """Train in place; return the CPU seconds without those of the reports."""
    schedule = SCHEDULE[options.schedule]
    epochs = options.epochs or schedule.epochs
    optimiser = torch.optim.Adam(network.parameters(), lr=schedule.rate)
    generator = torch.Generator().manual_seed(seed)
    count = x.shape[2]
    steps = -(-count // schedule.batch)
    seconds = 0.0
    for epoch in range(epochs):
        begin = time.process_time()
        order = torch.randperm(count, generator=generator)
        for number, part in enumerate(torch.split(order, schedule.batch)):
            if schedule.cycle:
                place = (epoch + number / steps) / epochs
                for group in optimiser.param_groups:
                    group["lr"] = schedule.rate * one_cycle(place, WARM_UP)
            answer, _ = network(x[:, :, part], network.cold(part.numel()))
            loss = (answer[-1] - y[:, part]).square().mean()
            optimiser.zero_grad()
            loss.backward()
            if schedule.cycle:
                torch.nn.utils.clip_grad_norm_(network.parameters(), GRADIENT_LIMIT)
            optimiser.step()
        seconds += time.process_time() - begin
        wanted = not options.report_epochs or epoch + 1 in options.report_epochs
        if options.report is not None and wanted:
            options.report(epoch + 1, seconds, conclude(seconds))
    return seconds


def _conclude(
    network: Network,
    windows: Windows,
    recurrent: bool,
    centre: Array,
    spread: Array,
    seconds: float,
) -> Fitted:
    """Return the network as a function of a run, with what it costs on the chip."""

    def predict(run: Run) -> Array:
        x = _arrange(windows, run, recurrent)
        parts = []
        with torch.no_grad():
            for part in torch.split(x, AT_ONCE, dim=2):
                answer, _ = network(part, network.cold(part.shape[2]))
                parts.append(answer[-1].T.numpy().astype(np.float64))
        return np.asarray(np.concatenate(parts) * spread + centre)

    return FittedFunction(
        function=predict,
        parameters=sum(p.numel() for p in network.parameters()),
        macs_per_step=count_macs(network, windows.length if recurrent else 1),
        fit_cpu_s=seconds,
        exportable=not recurrent or windows.steps == 1,
    )


def count_macs(network: Network, steps: int) -> int:
    """Return multiplications and additions of one answer, as the chip computes it.

    Args:
        network: the network.
        steps: samples that a recurrent one walks through for it.
    """
    if isinstance(network, GruNetwork):
        return steps * (network.w_x.numel() + network.w_h.numel()) + network.head.numel()
    assert isinstance(network, FeedForwardNetwork)
    head = dict(network.named_parameters())["head"].numel()
    return sum(layer.weight.size for layer in network.to_dense()) + head
