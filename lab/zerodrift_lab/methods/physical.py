"""Methods that know something of the sensor: effects, effects and a network, the lag bank."""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from zerodrift.base.config import Config, EffectConfig, NetworkConfig, OutputConfig
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.physics.fit import fit as fit_effects
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.lag_bank.fit import UNITS, fit_lag_bank
from zerodrift_lab.methods.interface import (
    Fit,
    Fitted,
    FittedFunction,
    Options,
    list_outputs,
)

DEFAULT_EFFECTS = (EffectConfig("dark_current"),)
"""Of an optical sensor; what its powers of two are, no few powers of the temperature can be."""


def _fit_physics(runs: Sequence[Run], options: Options) -> PhysicalModel:
    names, full_scale = list_outputs(runs, options)
    return fit_effects(
        options.effects, runs, outputs=names, units=("",) * len(names), full_scale=full_scale
    )


def fit_physics(runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
    """Return the effects of the options, fitted."""
    begin = time.process_time()
    model = _fit_physics(runs, options)
    return FittedFunction(
        function=model.predict,
        parameters=count_parameters(model),
        macs_per_step=count_macs(model),
        fit_cpu_s=time.process_time() - begin,
        exportable=True,
        notes=model.notes,
    )


def count_parameters(model: PhysicalModel) -> int:
    """Return the coefficients that are not held at zero, and the fitted values."""
    free = sum(len(fitted.term.free) for fitted in model.terms)
    return int(np.count_nonzero(model.coefficients)) + free


def count_macs(model: PhysicalModel) -> int:
    """Return the multiplications of the sum, and two for each operation before it."""
    from zerodrift.operations.operation import list_nodes

    nodes = [n for n in list_nodes(model.graph().features) if n.op not in ("input", "constant")]
    return int(np.count_nonzero(model.coefficients)) + 2 * len(nodes)


def make_trained(network: NetworkConfig, effects: bool) -> Fit:
    """Return the fit that `zerodrift train` does with a `[network]` table.

    Args:
        network: the table; its seed is replaced.
        effects: whether the options' effects stand before it.
    """

    def fit(runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
        from zerodrift.train.training import train

        begin = time.process_time()
        with tempfile.TemporaryDirectory(prefix="zerodrift-") as scratch:
            config, dataset = make_project(runs, network, seed, options, effects, Path(scratch))
            config.build_directory.mkdir()
            compensator = train(config, dataset, resume=False).compensator
        return FittedFunction(
            function=compensator.predict,
            parameters=compensator.parameters,
            macs_per_step=compensator.macs_per_step,
            fit_cpu_s=time.process_time() - begin,
            exportable=True,
            notes=compensator.notes,
        )

    return fit


def make_project(
    runs: Sequence[Run],
    network: NetworkConfig,
    seed: int,
    options: Options,
    effects: bool,
    directory: Path,
) -> tuple[Config, Dataset]:
    """Return a project that exists in memory only, with these runs as its training logs."""
    names, full_scale = list_outputs(runs, options)
    outputs = tuple(
        OutputConfig(name, name, 0.0, "", scale)
        for name, scale in zip(names, full_scale, strict=True)
    )
    config = Config(
        path=directory / "zerodrift.toml",
        sensor_name="sensor",
        time_column="time_s",
        temperature_column="temperature_degC",
        sample_period_s=runs[0].sample_period_s,
        outputs=outputs,
        inputs={name: name for name in options.thermometers},
        train_logs=(),
        test_logs=(),
        dwell_logs=(),
        effects=options.effects if effects else (),
        network=NetworkConfig(
            kind=network.kind,
            hidden=network.hidden,
            memory=network.memory,
            seed=seed,
            options=network.options,
            lags_s=network.lags_s,
        ),
        weights="int16",
        firmware_out=directory / "firmware",
        plugin_files=(),
    )
    dataset = Dataset(
        train=tuple(runs),
        test=(),
        dwell=(),
        outputs=names,
        units=("",) * len(names),
        full_scale=full_scale,
    )
    return config, dataset


def fit_bank(runs: Sequence[Run], *, seed: int, options: Options) -> Fitted:
    """Return the lag bank beside the options' effects; without any, beside the default ones."""
    begin = time.process_time()
    if not options.effects:
        options = replace(options, effects=DEFAULT_EFFECTS)
    physics = _fit_physics(runs, options)
    sources = ("temperature_degC", *options.thermometers)
    fitted = fit_lag_bank(physics, runs, sources, seed=seed, units=UNITS)
    units = fitted.weights.size + fitted.bias.size + fitted.head.size
    taps = 0 if fitted.front_end is None else fitted.front_end.width
    return FittedFunction(
        function=lambda run: physics.predict(run) + fitted.correct(run, physics),
        parameters=count_parameters(physics) + fitted.bank.parameters + units,
        macs_per_step=count_macs(physics)
        + fitted.bank.macs
        + fitted.weights.size
        + fitted.head.size
        + taps * (taps + 1) // 2,
        fit_cpu_s=time.process_time() - begin,
        exportable=True,
        notes=fitted.notes,
    )
