"""What the network should see: the default training with other inputs, on the bundled example.

    python -m benchmarks.study_inputs

Prints, for each choice of inputs, the error on each simulated held-out run and the CPU seconds of
the whole training. The evidence of `docs/decisions/020-what-the-network-sees.md`.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import torch

from benchmarks.bench_training import copy_example, measure_error
from zerodrift.base.config import Config, load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.train import stages
from zerodrift.train.front_end import FrontEnd, Tap, fit_front_end
from zerodrift.train.training import train

BANKS: dict[str, tuple[float, ...] | None] = {
    "lags chosen from the logs": (),
    "one lag, 20 s": (20.0,),
    "one lag, 200 s": (200.0,),
    "one lag, 2000 s": (2000.0,),
    "bank 10, 100, 1000 s": (10.0, 100.0, 1000.0),
    "bank 10, 30, 100, 300, 1000 s": (10.0, 30.0, 100.0, 300.0, 1000.0),
    "temperature alone": None,
}


def fit_plain(taps: Sequence[Tap], runs: Sequence[Run]) -> FrontEnd:
    """Return a front end whose taps are scaled to unit variance, but left correlated."""
    whole = fit_front_end(taps, runs)
    together = np.concatenate([whole.compute(run) for run in runs])
    taps_of = together @ np.linalg.inv(whole.matrix).T
    return replace(whole, matrix=np.diag(1.0 / taps_of.std(axis=0)))


def measure(config: Config, dataset: Dataset) -> tuple[list[float], float]:
    """Return the error on each held-out run, % of the drift's RMS, and CPU seconds."""
    scale = np.concatenate([run.drift for run in dataset.train]).std(axis=0)
    begin = time.process_time()
    compensator = train(config, dataset, resume=False).compensator
    seconds = time.process_time() - begin
    errors = [
        measure_error([compensator.predict(run)], [run], scale, compensator.tared)
        for run in dataset.test
    ]
    return errors, seconds


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as scratch:
        project = Path(scratch)
        copy_example(project)
        config = load_config(project)
        dataset = load_dataset(config)
        config.build_directory.mkdir()
        names = [run.name.removeprefix("test_").removesuffix("_1") for run in dataset.test]
        print(f"{'inputs (simulated logs, % of drift RMS)':42s}", *(f"{n:>9s}" for n in names))

        def show(title: str, settings: Config) -> None:
            errors, seconds = measure(settings, dataset)
            row = " ".join(f"{error:9.3f}" for error in errors)
            print(f"{title:42s} {row} {seconds:8.1f} CPU s", flush=True)

        for title, lags_s in BANKS.items():
            settings = replace(config, network=replace(config.network, lags_s=lags_s or ()))
            if lags_s is None:
                with patch.object(stages, "choose_lags", lambda *_: ()):
                    show(title, settings)
            else:
                show(title, settings)
        with patch.object(stages, "fit_front_end", fit_plain):
            show("lags chosen, not decorrelated", config)
        window = replace(config, network=replace(config.network, memory=10))
        show("window of 10, lags chosen", window)
        with patch.object(stages, "choose_lags", lambda *_: ()):
            show("window of 10, temperature alone", window)


if __name__ == "__main__":
    main()
