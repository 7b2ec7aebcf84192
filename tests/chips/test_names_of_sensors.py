"""A sensor may have the name of a file that its C is compiled beside."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.surroundings.conftest import write_project

from zerodrift.base.config import load_config
from zerodrift.c_runtime.emulator import EmulatedModel
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.c_runtime.host import build_host_batch
from zerodrift.codegen.generate import generate
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import compose_integer_model, describe_compensator, encode_inputs
from zerodrift.export.integer_model import IntegerModel
from zerodrift.train.training import train
from zerodrift.verify.host_check import check_host

CORE = "cortex-m4"
NAMES = ("unit", "main", "harness", "sanitized", "together", "object", "run")


@pytest.fixture(scope="module")
def model_and_codes(tmp_path_factory: pytest.TempPathFactory) -> tuple[IntegerModel, np.ndarray]:
    config = load_config(write_project(tmp_path_factory.mktemp("names") / "project"))
    dataset = load_dataset(config)
    described = describe_compensator(train(config, dataset).compensator, config, dataset.train)
    model = compose_integer_model(described, config, dataset)
    return model, encode_inputs(model, dataset.train[0])[:20]


@pytest.mark.spread(2, "name", NAMES)
def test_its_c_compiles_is_measured_and_runs(
    name: str, model_and_codes: tuple[IntegerModel, np.ndarray], tmp_path: Path
) -> None:
    model, codes = replace(model_and_codes[0], prefix=name), model_and_codes[1]
    code = generate(model)
    assert measure_footprint(code, CORE).flash_bytes > 0
    chip = EmulatedModel(model, code, CORE, tmp_path)
    assert max(chip.count_instructions(codes)) > 0
    (host,) = build_host_batch([model], [code], tmp_path / "batch")
    assert check_host(host, codes, settled=True).mismatch is None
