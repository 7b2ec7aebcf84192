"""Units of which some need a limit that others never reach: one program for all of them."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.blocks.test_blocks import make_block
from tests.blocks.units import LSB_K, PERIOD_S
from zerodrift.base.errors import CheckError
from zerodrift.blocks.align import share_clips
from zerodrift.blocks.design import make_design
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate_design
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import Channel, IntegerModel, OutputFormat
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import GraphOperations
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

BELOW, ABOVE = 14.0, 7.0
"""K in which the current doubles: it stays below its limit in the whole range, or does not."""


@cache
def make_unit(doubling_K: float) -> IntegerModel:
    """Return a unit with two currents, each limited to 64 of its values at 20 degC; the second one
    doubles 2 K later."""
    ops = GraphOperations(PERIOD_S)
    rise = ops.affine(ops.input("temperature_degC"), 1.0, -20.0)
    features = tuple(
        ops.clip(ops.exp2(ops.affine(rise, 1.0 / doubling, 0.0)), 0.0, 64.0)
        for doubling in (doubling_K, doubling_K + 2.0)
    )
    model = FloatModel(
        name="cell",
        sample_period_s=PERIOD_S,
        channels=(Channel("temperature", "degC", LSB_K, no_reading=-32768),),
        sources={"temperature_degC": 0},
        outputs=(OutputFormat("F0", "N", 10_000, 200.0),),
        features=(*features, rise),
        coefficients=np.array([[0.02], [-0.01], [0.03]]),
        offset=np.array([0.1]),
    )
    limits = (round(-40 / LSB_K), round(80 / LSB_K))
    calibration = Calibration(
        code_limits=(limits,),
        feature_max=np.zeros(0),
        drift_low=np.array([-5.0]),
        drift_high=np.array([5.0]),
        rate_max=19,
        warm_up_steps=0,
        temperature_range=(round(-22 / LSB_K), round(62 / LSB_K)),
        ranges=dict.fromkeys(features, (-64.0, 64.0)) | {rise: (-100.0, 100.0)},
    )
    return quantize(model, calibration)


def count_clips(model: IntegerModel) -> int:
    """Return how many limits a model has."""
    return sum(node.kind == "clip" for node in model.nodes)


UNITS = (BELOW, ABOVE, 9.0, 13.0)


def test_some_units_need_a_limit_that_others_lack() -> None:
    assert {count_clips(make_unit(doubling)) for doubling in UNITS} == {0, 1, 2}


def test_a_limit_that_a_unit_lacks_changes_no_bit_of_it() -> None:
    units = [make_unit(doubling) for doubling in UNITS]
    for own, shared in zip(units, share_clips(units), strict=True):
        assert count_clips(shared) == 2
        for codes in draw_sequences(own, 500).values():
            one, other = (Reference(m).run(codes[None]) for m in (own, shared))
            assert np.array_equal(one.drift, other.drift)
            assert np.array_equal(one.flags, other.flags)


@pytest.mark.parametrize("order", [UNITS, UNITS[::-1]])
def test_one_program_computes_what_each_units_reference_does(
    order: tuple[float, ...], tmp_path: Path
) -> None:
    units = [make_unit(doubling) for doubling in order]
    design = make_design(units)
    host = HostModel(design.model, generate_design(design), tmp_path)
    for unit in units:
        model = design.fit(unit)
        assert host.use_block(make_block(design, model)) == 0
        assert host.selftest() == 0
        host.model = model
        for number, codes in enumerate(draw_sequences(model, 500).values()):
            check = check_host(host, codes, settled=number % 2 == 0)
            assert check.mismatch is None, check.mismatch


def test_a_later_unit_may_lack_a_limit_but_not_need_another() -> None:
    with_limits, without = make_unit(ABOVE), make_unit(BELOW)
    design = make_design([with_limits, make_unit(9.0)])
    assert count_clips(design.model) == 2
    assert count_clips(share_clips([without], design.model)[0]) == 2
    with pytest.raises(CheckError, match="need the same operations"):
        make_design([without]).fit(with_limits)


def test_units_that_are_alike_stay_what_they_are() -> None:
    units = [make_unit(BELOW), make_unit(BELOW)]
    assert all(a is b for a, b in zip(share_clips(units), units, strict=True))
