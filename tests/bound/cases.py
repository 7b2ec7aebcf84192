"""Models without a recurrent layer, drawn from a number, with signals that go to their limits."""

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from benchmarks.random_models import SORTS, draw_signals
from numpy.typing import NDArray

from tests.bound.float_answers import answer
from tests.certificate.test_check import list_texts
from zerodrift.base.errors import CheckError
from zerodrift.codegen.generate import generate
from zerodrift.export.error_bound import ErrorBound, bound_errors
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.quantize import Quantized, quantize_graph
from zerodrift.export.reference import Reference
from zerodrift.operations.dense import FloatDense
from zerodrift.verify.certificate import certify

Array = NDArray[np.float64]
LIMITS = ((0.0, np.inf), (0.0, 6.0), (-1.0, 1.0), (-np.inf, np.inf))
FLOAT_ERROR = 1e-12
"""Of what the float model is computed with, as a share of its answers."""


@dataclass(frozen=True)
class Case:
    """A model, its ranges, and codes for it."""

    described: FloatModel
    calibration: Calibration
    quantized: Quantized
    codes: NDArray[np.int64]  # [B, T, C]

    @classmethod
    def of(cls, described: FloatModel, calibration: Calibration, weights: str = "int16") -> "Case":
        """Return the case of a float model, without codes."""
        quantized = quantize_graph(described, calibration, weights)
        return cls(described, calibration, quantized, np.zeros((0, 0, 0), dtype=np.int64))

    def bound(self) -> ErrorBound:
        """Return what is proven."""
        return bound_errors(self.quantized)

    def certify(self) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the certificate and the texts of the C."""
        model = self.quantized.model
        code = generate(model)
        return json.loads(certify(model, code, self.bound())), list_texts(code)

    def measure(self) -> Array:
        """Return |chip - float model| [B, T, K], less what double precision rounds."""
        codes = self.codes.copy()
        for i, channel in enumerate(self.quantized.model.channels):
            if channel.no_reading is not None:  # both would hold the last reading
                missing = codes[..., i] == channel.no_reading
                codes[..., i] = np.where(missing, channel.no_reading + 1, codes[..., i])
        floats = answer(self.described, self.calibration, self.quantized, codes)
        scale = [output.lsb_per_unit for output in self.described.outputs]
        chip = Reference(self.quantized.model).run(codes, settled=True).drift / np.array(scale)
        gap = np.abs(chip - floats) - FLOAT_ERROR * np.abs(floats).max(axis=(0, 1))
        return np.asarray(np.maximum(gap, 0.0))


def draw_case(seed: int, number: int) -> Case:
    """Return effects of the catalogue, a graph of any operations, or a network of any shape."""
    rng = np.random.default_rng((seed, number))
    sort = str(rng.choice(list(SORTS)))
    while True:
        try:
            (described, calibration), logs = SORTS[sort](rng)
            described = _feed_forward(rng, described)
            quantized = quantize_graph(described, calibration)
            break
        except CheckError:
            continue
    codes = draw_signals(rng, quantized.model, logs).astype(np.int64)
    return Case(described, calibration, quantized, codes)


def _feed_forward(rng: np.random.Generator, described: FloatModel) -> FloatModel:
    """Return the model with dense layers in the place of its network, if it has one."""
    if described.network is None:
        return described
    assert described.whitening is not None
    layers, inputs = [], described.whitening.shape[0]
    for _ in range(rng.integers(1, 3)):
        rows = int(rng.integers(1, 17))
        gain = rng.choice([0.1, 1.0, 3.0]) / np.sqrt(inputs)
        weight, bias = gain * rng.normal(size=(rows, inputs)), rng.normal(size=rows)
        if rng.random() < 0.5:
            layers.append(FloatDense(weight, bias, "tanh"))
        else:
            layers.append(FloatDense(weight, bias, "clip", *LIMITS[rng.integers(len(LIMITS))]))
        inputs = rows
    outputs = len(described.outputs)
    network = FloatNetwork.stack(
        layers, rng.normal(size=(outputs, inputs)), rng.normal(size=outputs)
    )
    return replace(described, network=network, window=0)
