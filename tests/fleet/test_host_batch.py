"""Models with the same C names in one library: each is still itself."""

from dataclasses import replace

import numpy as np
import pytest
from tests.golden.model_factory import Shape, draw_model

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.host import build_host_batch, include_renamed
from zerodrift.codegen.generate import generate
from zerodrift.verify.host_check import check_host

SHAPES = (
    Shape(hidden=8, outputs=2),
    Shape(front_end=("lowpass",), update_bias=-2.0, code_limit=10000),
    Shape(hidden=3, reset="before"),
    Shape(hidden=5, weights="int8"),
)


def draw_models():
    return [replace(draw_model(shape, number), name="same") for number, shape in enumerate(SHAPES)]


@pytest.mark.parametrize("observe", [False, True])
def test_models_of_one_name_share_a_library_and_keep_to_themselves(tmp_path, observe):
    models = draw_models()
    codes = [generate(model) for model in models]
    assert len({code.prefix for code in codes}) == 1
    hosts = build_host_batch(models, codes, tmp_path, observe=observe)
    assert len({host.library for host in hosts}) == 1
    rng = np.random.default_rng(0)
    drifts = []
    for host in hosts:
        width = len(host.model.channels)
        raw = rng.integers(-5000, 12000, (300, width)).astype(host.model.code_type)
        for settled in (True, False):
            assert check_host(host, raw, settled=settled).mismatch is None
        assert host.selftest() == 0
        assert host.restore(host.save()) == 0
        drifts.append(host.run(raw).drift)
    # In turn, and again: no model writes into another's state.
    rng = np.random.default_rng(0)
    for host, before in zip(hosts, drifts, strict=True):
        width = len(host.model.channels)
        raw = rng.integers(-5000, 12000, (300, width)).astype(host.model.code_type)
        np.testing.assert_array_equal(host.run(raw).drift, before)


def test_source_that_differs_from_its_model_is_found_in_its_place(tmp_path):
    models = draw_models()[:2]
    codes = [generate(model) for model in models]
    # The code of another model of the same shape: same names, other weights.
    other = generate(replace(draw_model(SHAPES[1], 99), name="same"))
    hosts = build_host_batch(models, [codes[0], other], tmp_path)
    raw = np.random.default_rng(1).integers(-5000, 12000, (200, 4))
    found = [
        check_host(h, raw[:, : len(h.model.channels)].astype(h.model.code_type)).mismatch
        for h in hosts
    ]
    assert found[0] is None
    assert found[1] is not None


def test_source_that_does_not_compile_is_refused(tmp_path):
    [model] = draw_models()[:1]
    code = generate(model)
    with pytest.raises(CheckError, match="failed with exit code"):
        build_host_batch([model], [replace(code, source="#error no")], tmp_path)


def test_included_text_is_the_source_itself(tmp_path):
    [model] = draw_models()[:1]
    code = generate(model)
    build_host_batch([model], [code], tmp_path)
    assert (tmp_path / "0" / code.source_name).read_text() == code.source
    assert (tmp_path / "0" / code.header_name).read_text() == code.header
    lines = include_renamed(code, 0).splitlines()
    assert all(line.startswith(("#define", "#include", "#undef")) for line in lines)
