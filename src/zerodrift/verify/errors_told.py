"""The error of a compensator in physical units: uncompensated, float, integer, per output."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.c_runtime.host import HostModel
from zerodrift.dataset.runs import Run, predict_all, predict_along
from zerodrift.diagnosis.baselines import explain_share
from zerodrift.export.compose import count_elapsed, encode_inputs
from zerodrift.export.float_model import FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel
from zerodrift.verify.summary import ConversionSummary

# What `firmware` reports on the inputs whose raw codes the chip converts.


def summarise_conversions(model: IntegerModel) -> dict[str, ConversionSummary]:
    """Return input -> how its raw codes are converted, of those that a table converts."""
    found = {channel.name: _summarise(channel) for channel in model.channels}
    return {name: told for name, told in found.items() if told is not None}


def _summarise(channel: Channel) -> ConversionSummary | None:
    by = channel.conversion
    if by is None or by.is_plain:
        return None
    low, high = (end * channel.lsb + channel.offset for end in (by.lowest, by.highest))
    return ConversionSummary(
        raw=by.raw,
        unit=channel.unit,
        covers=(low, high),
        readings=(by.begin, by.end),
        cold_junction=by.formula.junction,
        table_bytes=by.table_bytes,
        lsb=channel.lsb,
        error=by.error,
        code_worth=by.worth,
    )


def tell_conversions(model: IntegerModel) -> list[str]:
    """Return a line for each of them: the table, and where the hardware is the coarser."""
    lines = []
    for name, told in summarise_conversions(model).items():
        line = (
            f"{name} is converted from {told.raw} codes: {told.covers[0]:.4g} to"
            f" {told.covers[1]:.4g} {told.unit} within {told.error:.2g} {told.unit}, table of"
            f" {told.table_bytes} B"
        )
        if told.cold_junction is not None:
            line += f"; its cold junction is {told.cold_junction}"
        if told.code_worth[1] > told.lsb:
            line += (
                f"; one raw code is worth {told.code_worth[0]:.2g} to {told.code_worth[1]:.2g}"
                f" {told.unit}, the result's code {told.lsb:.2g}"
            )
        lines.append(line)
    return lines


# The error of a compensator in physical units: uncompensated, float, integer, per output.


@dataclass(frozen=True)
class OutputError:
    """Root mean square errors of one output over a set of runs, in its unit."""

    name: str
    unit: str
    full_scale: float
    uncompensated: float
    physics: float | None
    """Of the physical model alone; None where there is nothing beside it, or no such model."""
    float_model: float
    integer_model: float
    integer_to_float: float
    """Root mean square difference of the two models: what quantization costs."""
    integer_bias: float
    """Mean of measurement minus integer model; rmse^2 = bias^2 + scatter^2."""
    explained: float
    """Share of the squared error that the integer model takes away beyond a constant."""

    @property
    def is_hurt(self) -> bool:
        """Whether the physical model alone errs less than with what was learnt beside it."""
        return self.physics is not None and self.physics < self.float_model

    @property
    def percent_of_full_scale(self) -> float:
        """The integer model's error in %FS."""
        return 100.0 * self.integer_model / self.full_scale


def tell_errors(
    model: FloatModel, host: HostModel, runs: Sequence[Run], constant: Mapping[str, Array]
) -> tuple[OutputError, ...]:
    """Return the errors over all samples of `runs`.

    Where training found the logs tared, the offset of each run is not predictable and is subtracted
    from every error, as in `compare` and `train`.

    Args:
        model: the float model.
        host: the integer model's C, already shown equal to the reference.
        runs: measurements, preferably held out.
        constant: run's name -> [n, K] what a constant fitted to the training runs predicts.
    """
    outputs = host.model.outputs
    floats = model.predict_all_on_chip(runs)
    integers = predict_all(lambda run: predict_by_c(host, run), runs)
    none = [np.zeros_like(run.drift) for run in runs]
    uncompensated, float_error, integer_error = (
        _join(runs, answer, model.tared) for answer in (none, floats, integers)
    )
    alone = model.physics
    physics = None if alone is None else _join(runs, alone.predict_all(runs), model.tared)
    plain = _join(runs, [constant[run.name] for run in runs], model.tared)
    explained = explain_share(np.sum(integer_error**2, axis=0), np.sum(plain**2, axis=0))
    difference = np.concatenate(floats) - np.concatenate(integers)
    return tuple(
        OutputError(
            name=output.name,
            unit=output.unit,
            full_scale=output.full_scale,
            uncompensated=_rms(uncompensated[:, k]),
            physics=None if physics is None else _rms(physics[:, k]),
            float_model=_rms(float_error[:, k]),
            integer_model=_rms(integer_error[:, k]),
            integer_to_float=_rms(difference[:, k]),
            integer_bias=float(np.mean(integer_error[:, k])),
            explained=float(explained[k]),
        )
        for k, output in enumerate(outputs)
    )


def predict_by_c(host: HostModel, run: Run) -> Array:
    """Return the drift [n, K] that the C computes for a run, in each output's unit."""
    if run.before is not None:
        return predict_along(lambda whole: predict_by_c(host, whole), run)
    model = host.model
    trace = host.run(encode_inputs(model, run), elapsed=count_elapsed(model, run))
    scale = np.array([output.lsb_per_unit for output in model.outputs], dtype=np.float64)
    return np.asarray(trace.drift / scale)


def _join(runs: Sequence[Run], predictions: Sequence[Array], tared: bool) -> Array:
    """Return the errors [n, K] of all runs, each group's own mean taken off where `tared`."""
    errors = [run.drift - answer for run, answer in zip(runs, predictions, strict=True)]
    if tared:
        means = {
            group: np.concatenate(
                [e for r, e in zip(runs, errors, strict=True) if r.group == group]
            ).mean(axis=0)
            for group in {run.group for run in runs}
        }
        errors = [e - means[run.group] for run, e in zip(runs, errors, strict=True)]
    return np.concatenate(errors)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
