"""A cold start is sound, also where zero lies outside everything that calibration saw."""

from pathlib import Path

import numpy as np

from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import Channel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.operations.backend import GraphOperations
from zerodrift.verify.host_check import check_host


def test_cold_start_away_from_zero_is_not_taken_for_damage(tmp_path: Path) -> None:
    """The low-pass state of a new sensor is 0, which this one can never hold while it runs."""
    ops = GraphOperations(1.0)
    temperature = ops.input("temperature_degC")
    delayed = ops.delay(temperature, 3.0)
    model = quantize(
        FloatModel(
            name="warm",
            sample_period_s=1.0,
            channels=(Channel("temperature", "degC", 2.0**-7),),
            sources={"temperature_degC": 0},
            outputs=(OutputFormat("F", "N", 1000, 100.0),),
            features=(ops.lowpass(temperature, 40.0), delayed),
            coefficients=np.array([[0.5], [0.25]]),
            offset=np.zeros(1),
        ),
        Calibration(
            code_limits=((2000, 5000),),
            feature_max=np.zeros(0),
            drift_low=np.array([-100.0]),
            drift_high=np.array([100.0]),
            rate_max=100,
            warm_up_steps=0,
        ),
    )
    host = HostModel(model, generate(model), tmp_path)
    codes = np.linspace(2500, 4500, 200).astype(np.int16)[:, None]
    for settled in (False, True):
        outcome = check_host(host, codes, settled=settled)
        assert outcome.mismatch is None, outcome.mismatch
        assert not host.run(codes, settled=settled).flags.any()
