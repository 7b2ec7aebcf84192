"""The cost of a formula on the chip: the model's C with it and without, compiled and counted."""

import importlib.util
from dataclasses import replace
from pathlib import Path

from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.scratch import make_scratch
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.codegen.generate import generate
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.formula.proposal import Formula
from zerodrift.export.compose import (
    compose_integer_model,
    describe_compensator,
    encode_inputs,
    predict_integer,
)
from zerodrift.physics.model import PhysicalModel
from zerodrift.report.results import ProposedCost
from zerodrift.train.prepare import read_settings, stand_alone
from zerodrift.verify.chip_check import COUNTED_STEPS

CORE = "cortex-m4"


def measure_cost(config: Config, dataset: Dataset, formula: Formula) -> tuple[ProposedCost, str]:
    """Return what the formula adds on a Cortex-M4, and why a figure is missing.

    The network is left out: its cost does not change.

    Args:
        config: the project.
        dataset: its runs.
        formula: as fitted.
    """
    revision = formula.revision
    try:
        with make_scratch(config.directory) as scratch:
            before = _measure(config, dataset, revision.before.model, scratch / "before")
            after = _measure(config, dataset, revision.after.model, scratch / "after")
    except (CheckError, InputError) as error:
        return ProposedCost({}, {}, {}), str(error)
    if before is None or after is None:
        return ProposedCost({}, {}, {}), f"no compiler or emulator for {CORE} on this machine"
    rounding = dict(zip(dataset.outputs, after[2], strict=True))
    return (
        ProposedCost({CORE: after[0] - before[0]}, {CORE: after[1] - before[1]}, rounding),
        "",
    )


def _measure(
    config: Config, dataset: Dataset, physics: PhysicalModel, folder: Path
) -> tuple[int, int, list[float]] | None:
    """Return instructions per step, bytes of flash, and the RMS [K] of the quantization error."""
    if importlib.util.find_spec("unicorn") is None or not find_cross_compilers(CORE):
        return None
    from zerodrift.c_runtime.emulator import EmulatedModel

    plain = replace(config, network=replace(config.network, kind="none"))
    compensator = stand_alone(plain, dataset, physics, read_settings(plain.network))
    described = describe_compensator(compensator, plain, dataset.train)
    model = compose_integer_model(described, plain, dataset)
    code = generate(model)
    folder.mkdir()
    chip = EmulatedModel(model, code, CORE, folder)
    run = dataset.train[0]
    counts = chip.count_instructions(encode_inputs(model, run)[:COUNTED_STEPS])
    error = predict_integer(model, run) - physics.predict(run)
    rms = ((error - error.mean(axis=0)) ** 2).mean(axis=0) ** 0.5
    return max(counts), measure_footprint(code, CORE).flash_bytes, rms.tolist()
