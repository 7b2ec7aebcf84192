"""A GRU over every signal, trained without each part of the runs. Needs PyTorch."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from zerodrift.base.arrays import Array
from zerodrift.base.config import NetworkConfig
from zerodrift.base.errors import InputError
from zerodrift.train.black_box.signals import Lesson, average, choose_block, measure_unit
from zerodrift.train.engine import EpochProgress, Problem, Result, train_networks
from zerodrift.train.networks import Network, build_network
from zerodrift.train.prepare import read_settings
from zerodrift.train.refits import split_parts
from zerodrift.train.sequences import Sequence32

MOST_ROWS = 12_000
"""Rows of all runs together; longer logs are shown as block means."""
LEAST_LEFT = 1e-3
"""Added to the variance of each signal, so that two that are nearly one are not told apart."""
GRU = NetworkConfig(kind="gru")
"""As a project's GRU is by default: units, rates, epochs."""


def learn_network(
    lessons: Sequence[Lesson], report: Callable[[float], None] = lambda done: None
) -> list[Mapping[str, Array]]:
    """Return for each lesson run's name -> [n, K] what networks add that never saw the run.

    All networks are trained in parallel.

    Args:
        lessons: what to learn, over the same runs.
        report: called with the share that is done.

    Raises:
        InputError: a training diverged.
    """
    settings = replace(read_settings(GRU), starts=(0,))
    problems, shown, units = [], [], []
    for lesson in lessons:
        block = choose_block(lesson.runs, MOST_ROWS)
        unit = measure_unit(lesson)
        sequences = _show(lesson, block, unit)
        shown.append(sequences)
        units.append(unit)
        width, outputs = sequences[0].features.shape[1], unit.size

        def build(
            generator: torch.Generator, width: int = width, outputs: int = outputs
        ) -> Network:
            return build_network(GRU, width, outputs, generator)

        problems += [
            Problem(
                build, [s for s in sequences if s.group not in part], (), settings, lesson.tared
            )
            for part in split_parts(lesson.runs)
        ]

    def tell(progress: EpochProgress) -> None:
        report(progress.done)

    results = iter(train_networks(problems, report=tell))
    found: list[Mapping[str, Array]] = []
    for lesson, sequences, unit in zip(lessons, shown, units, strict=True):
        answers: dict[str, Array] = {}
        for part in split_parts(lesson.runs):
            result = next(results)
            if isinstance(result, InputError):
                raise result
            for run, sequence in zip(lesson.runs, sequences, strict=True):
                if run.group in part:
                    told = _ask(result, sequence, unit.size) * unit
                    answers[run.name] = _stretch(
                        told, len(run), choose_block(lesson.runs, MOST_ROWS)
                    )
        found.append(answers)
    return found


def _show(lesson: Lesson, block: int, unit: Array) -> list[Sequence32]:
    """Return the runs as the network sees them, signals decorrelated."""
    together = np.concatenate(lesson.signals)
    covariance = np.atleast_2d(np.cov(together, rowvar=False, bias=True))
    factor = np.linalg.cholesky(covariance + LEAST_LEFT * np.eye(len(covariance)))
    matrix = np.linalg.inv(factor)
    return [
        Sequence32(
            group=run.group,
            features=average(signals @ matrix.T, block).astype(np.float32),
            target=average(rest / unit, block).astype(np.float32),
            skip=0,
        )
        for run, signals, rest in zip(lesson.runs, lesson.signals, lesson.rests, strict=True)
    ]


def _ask(result: Result, sequence: Sequence32, outputs: int) -> Array:
    """Return a trained network's prediction [n, K] for a run."""
    features = torch.from_numpy(sequence.features)[:, :, None]
    network = build_network(GRU, features.shape[1], outputs, torch.Generator())
    network.load_state_dict({k: torch.from_numpy(v) for k, v in result.weights.items()})
    with torch.no_grad():
        drift, _ = network(features, network.rest(features[0]))
    return np.asarray(drift[:, :, 0].numpy(), dtype=np.float64)


def _stretch(means: Array, rows: int, block: int) -> Array:
    """Return [rows, K] straight lines between the middles of blocks."""
    if block == 1:
        return means
    middles = block * np.arange(len(means)) + 0.5 * (block - 1)
    at = np.arange(rows)
    return np.stack([np.interp(at, middles, column) for column in means.T], axis=1)
