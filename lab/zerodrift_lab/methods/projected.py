"""The paper's GRU trained in seconds: whitened taps, its head solved, the rest by L-BFGS.

The ten samples of a window are almost the same number. Each is replaced by what it adds to the
newer ones, at unit variance, though never blown up below a multiple of the thermometer's step: a
triangular matrix in front of the same network. Given the recurrence, the head is linear; it is
solved exactly at every evaluation, and what remains is a smooth function of the recurrence alone,
whose gradient is that of the squared error with the head held (variable projection, Golub and
Pereyra 1973). L-BFGS (Liu and Nocedal 1989) takes it down over all windows at once: first over
means of a few neighbours, which differ by little but noise and cost a fraction, then over every
window, with the noise that the network will see.
"""

import contextlib
import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from torch import Tensor

from zerodrift.base.arrays import Array
from zerodrift.dataset.runs import Run
from zerodrift.train.networks import FORMS, GruNetwork
from zerodrift_lab.methods.interface import Fit, Fitted, FittedFunction, Options
from zerodrift_lab.methods.networks import AT_ONCE, WINDOW, count_macs, make_gru
from zerodrift_lab.methods.windows import Windows, fit_windows

STAGES = ((4, 50), (1, 20))
"""Neighbouring windows that are averaged, and evaluations of the error and its gradient."""
RIDGE = 3e-7
"""Weight of the recurrence's and the head's squares beside the mean squared error at unit scale."""
REMEMBERED = 30
"""Steps from which L-BFGS guesses the curvature."""
STEP_K = 1.0 / 128.0
"""Of the TMP117 thermometer."""
NOISE_GAIN = 10.0
"""A tap is not scaled up where it spreads less than this multiple of the step's own noise."""


class _EnoughError(Exception):
    """All evaluations are spent."""


@dataclass(frozen=True)
class Whitening:
    """What each sample of a window adds to the newer ones, of about unit variance."""

    matrix: Array
    """[T, T] lower triangular, for samples newest first."""

    def apply(self, windows: Windows, run: Run) -> NDArray[np.float32]:
        """Return the taps [T, 1, n] of a run, oldest first as a recurrence walks through them."""
        cut = windows.cut(run)[:, :, 0]  # [n, T]
        return np.ascontiguousarray((self.matrix @ cut.T)[::-1, None], dtype=np.float32)


def fit_whitening(windows: Windows, runs: Sequence[Run]) -> Whitening:
    """Return the whitening of one thermometer's windows."""
    cuts = np.concatenate([windows.cut(run)[:, :, 0] for run in runs])
    together = cuts.T @ cuts / len(cuts) + 1e-12 * np.eye(cuts.shape[1])
    factor = np.linalg.cholesky(together)
    spread = np.diag(factor)
    least = NOISE_GAIN * STEP_K / np.sqrt(12.0) / float(windows.spread[0])
    adds = np.linalg.inv(factor / spread)
    return Whitening(adds / np.maximum(spread, least)[:, None])


def average(
    x: NDArray[np.float32], lengths: Sequence[int], block: int
) -> tuple[NDArray[np.float32], Array]:
    """Return the means of neighbours within each run [..., m], and how many they are [m].

    Args:
        x: [..., n], runs end to end.
        lengths: of the runs.
        block: how many neighbours; fewer at the end of a run.
    """
    ends = np.cumsum([0, *lengths])
    starts = np.concatenate([np.arange(a, b, block) for a, b in itertools.pairwise(ends)])
    counts = np.diff(np.append(starts, ends[-1])).astype(np.float64)
    return (np.add.reduceat(x, starts, axis=-1) / counts).astype(np.float32), counts


class Projected:
    """The mean squared error of a GRU, its head solved, as a function of the recurrence.

    Args:
        network: receives every value that is tried.
        x: [T, 1, m] taps.
        y: [K, m] targets of unit variance.
        counts: [m] samples behind each.
    """

    def __init__(
        self,
        network: GruNetwork,
        x: NDArray[np.float32],
        y: NDArray[np.float32],
        counts: Array,
    ) -> None:
        self._network = network
        self._x, self._y = torch.from_numpy(x), torch.from_numpy(y).double()
        self._weight = torch.from_numpy(counts / counts.sum())
        self._parts = [network.w_x, network.w_h, network.bias]

    @property
    def start(self) -> Array:
        """The recurrence as it is, [P]."""
        flat = torch.nn.utils.parameters_to_vector(self._parts)
        return np.asarray(flat.detach().numpy().astype(np.float64))

    def evaluate(self, values: Array) -> tuple[float, Array]:
        """Return the penalised error and its gradient [P]; the network is left with the head."""
        network, outputs = self._network, self._y.shape[0]
        flat = torch.from_numpy(values.astype(np.float32))
        torch.nn.utils.vector_to_parameters(flat, self._parts)
        for part in self._parts:
            part.grad = None
        cold = network.cold(self._x.shape[2])
        _, states = network(self._x, cold)
        hidden = states[-1].detach().double()
        columns = torch.cat([hidden, torch.ones_like(hidden[:1])])
        normal = (columns * self._weight) @ columns.T
        normal.diagonal()[:-1] += RIDGE
        head = torch.linalg.solve(normal, (columns * self._weight) @ self._y.T).T
        error = head @ columns - self._y
        pull = 2.0 / outputs * (head[:, :-1].T @ (error * self._weight))
        states[-1].backward(pull.float())
        with torch.no_grad():
            network.head.copy_(head[:, :-1])
            network.head_bias.copy_(head[:, -1])
        cost = float((self._weight * error**2).sum()) / outputs
        cost += RIDGE * (float((head[:, :-1] ** 2).sum()) / outputs + float(values @ values))
        slope = torch.cat([_read_gradient(part) for part in self._parts])
        return cost, slope.numpy().astype(np.float64) + 2.0 * RIDGE * values


def descend(problem: Projected, evaluations: int, follow: Callable[[], None]) -> None:
    """Leave the network at the least error that L-BFGS finds.

    Args:
        problem: where its network is, is the start.
        evaluations: of the error and its gradient.
        follow: called after each.
    """
    start = problem.start
    best, least, done = start, np.inf, 0

    def evaluate(values: Array) -> tuple[float, Array]:
        nonlocal best, least, done
        cost, slope = problem.evaluate(values)
        done += 1
        if cost < least:
            best, least = values.copy(), cost
        follow()
        if done >= evaluations:
            raise _EnoughError
        return cost, slope

    limits = {"maxcor": REMEMBERED, "maxiter": 10**6, "maxfun": 10**6, "ftol": 0.0, "gtol": 0.0}
    with contextlib.suppress(_EnoughError):
        minimize(evaluate, start, jac=True, method="L-BFGS-B", options=limits)
    problem.evaluate(best)


def _read_gradient(part: Tensor) -> Tensor:
    assert part.grad is not None
    return part.grad.flatten()


def make_projected(form: str) -> Fit:
    """Return the fit of the paper's GRU by variable projection.

    Args:
        form: reset gate "reset_before" or "reset_after" the recurrent product.
    """
    assert form in FORMS

    def fit(runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
        begin = time.process_time()
        torch.set_num_threads(1)
        windows = fit_windows(runs, (), WINDOW, options.spacing_s)
        whitening = fit_whitening(windows, runs)
        drift = np.concatenate([run.drift for run in runs])
        centre, spread = drift.mean(axis=0), drift.std(axis=0)
        spread = np.where(spread > 0.0, spread, 1.0)
        lengths = [len(run) for run in runs]
        taps = np.concatenate([whitening.apply(windows, run) for run in runs], axis=2)
        answers = ((drift - centre) / spread).T.astype(np.float32)
        torch.manual_seed(seed)
        network = make_gru(form)(1, len(spread))
        assert isinstance(network, GruNetwork)

        def predict(run: Run) -> Array:
            seen = torch.from_numpy(whitening.apply(windows, run))
            parts = []
            with torch.no_grad():
                for part in torch.split(seen, AT_ONCE, dim=2):
                    answer, _ = network(part, network.cold(part.shape[2]))
                    parts.append(answer[-1].T.numpy().astype(np.float64))
            return np.asarray(np.concatenate(parts) * spread + centre)

        def conclude(seconds: float) -> Fitted:
            triangle = WINDOW * (WINDOW + 1) // 2
            return FittedFunction(
                function=predict,
                parameters=sum(p.numel() for p in network.parameters()) + triangle,
                macs_per_step=count_macs(network, WINDOW) + triangle,
                fit_cpu_s=seconds,
                exportable=False,
            )

        aside, done = 0.0, 0

        def follow() -> None:
            nonlocal aside, done
            done += 1
            if options.report is not None and done in (options.report_epochs or (done,)):
                now = time.process_time()
                options.report(done, now - begin - aside, conclude(now - begin - aside))
                aside += time.process_time() - now

        for block, evaluations in STAGES:
            x, counts = average(taps, lengths, block)
            y, _ = average(answers, lengths, block)
            descend(Projected(network, x, y, counts), options.epochs or evaluations, follow)
        return conclude(time.process_time() - begin - aside)

    return fit
