"""The error of a compensator in physical units: uncompensated, float, integer, per output."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zerodrift.c_runtime.host import HostModel
from zerodrift.dataset.runs import Run
from zerodrift.export.compose import encode_inputs
from zerodrift.train.compensator import Compensator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OutputError:
    """Root mean square errors of one output over a set of runs, in its unit."""

    name: str
    unit: str
    full_scale: float
    uncompensated: float
    float_model: float
    integer_model: float
    integer_to_float: float
    """Root mean square difference of the two models: what quantization costs."""
    integer_bias: float
    """Mean of measurement minus integer model; rmse^2 = bias^2 + scatter^2."""

    @property
    def percent_of_full_scale(self) -> float:
        """The integer model's error in %FS."""
        return 100.0 * self.integer_model / self.full_scale


def tell_errors(
    compensator: Compensator, host: HostModel, runs: Sequence[Run]
) -> tuple[OutputError, ...]:
    """Return the errors over all samples of `runs`.

    Args:
        compensator: the float model.
        host: the integer model's C, already shown equal to the reference.
        runs: measurements, preferably held out.
    """
    outputs = host.model.outputs
    scale = np.array([output.lsb_per_unit for output in outputs], dtype=np.float64)
    drift = np.concatenate([run.drift for run in runs])
    float_drift = np.concatenate([compensator.predict(run) for run in runs])
    integer_drift = np.concatenate(
        [host.run(encode_inputs(host.model, run)).drift / scale for run in runs]
    )
    return tuple(
        OutputError(
            name=output.name,
            unit=output.unit,
            full_scale=output.full_scale,
            uncompensated=_rms(drift[:, k]),
            float_model=_rms(drift[:, k] - float_drift[:, k]),
            integer_model=_rms(drift[:, k] - integer_drift[:, k]),
            integer_to_float=_rms(float_drift[:, k] - integer_drift[:, k]),
            integer_bias=float(np.mean(drift[:, k] - integer_drift[:, k])),
        )
        for k, output in enumerate(outputs)
    )


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))
