"""Replays a project's golden vectors on the reference and on the C as it lies in its folder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.config import Config
from zerodrift.errors import CheckError, InputError
from zerodrift.export.golden import GoldenVectors, load_golden
from zerodrift.export.integer_model import IntegerModel, load_model
from zerodrift.export.reference import Reference
from zerodrift.scratch import make_scratch
from zerodrift.verify.firmware_check import Failure, Progress, check_firmware
from zerodrift.verify.mismatch import find_mismatch
from zerodrift.verify.vectors import draw_sequences

RANDOM_STEPS = 20_000


@dataclass(frozen=True)
class Replay:
    """What was replayed, and the first failure if there was one."""

    vectors: int
    backends: tuple[str, ...]
    model_hash: str
    failure: Failure | None

    def require(self) -> "Replay":
        """Return self.

        Raises:
            CheckError: a back end differs; names step, place, expected and actual value.
        """
        if self.failure is not None:
            raise CheckError(f"bits differ: {self.failure}. Run `zerodrift firmware` again.")
        return self


def replay(config: Config, progress: Progress = lambda _: None) -> Replay:
    """Replay build/golden.npz and random sequences on everything that the project has built.

    Args:
        config: the project.
        progress: is told what is being done.

    Raises:
        InputError: nothing was built yet, or a file is damaged or belongs to another model.
    """
    model = load_model(config.build_directory / "model.json")
    golden = load_golden(config.build_directory / "golden.npz")
    if golden.model_hash != model.hash:
        raise InputError(
            f"{config.build_directory / 'golden.npz'}: belongs to model {golden.model_hash[:12]},"
            f" model.json is {model.hash[:12]}. Run `zerodrift firmware`."
        )
    failure = check_golden(model, golden)
    if failure is not None:
        return Replay(len(golden.codes), ("reference",), model.hash, failure)
    code = read_code(model, config.firmware_out)
    sequences = {"golden": golden.codes, **draw_sequences(model, RANDOM_STEPS)}
    with make_scratch(config.directory) as scratch:
        check = check_firmware(model, code, sequences, scratch, progress)
    return Replay(check.vectors, check.backends, model.hash, check.failure)


def check_golden(model: IntegerModel, golden: GoldenVectors) -> Failure | None:
    """Return where the reference differs from the golden vectors, or None."""
    trace = Reference(model).run(golden.codes[None])
    labels = [f"drift[{k}]" for k in range(len(model.outputs))] + ["flags"]
    labels += [f"gru[{j}]" for j in range(golden.hidden.shape[1])]
    expected = np.column_stack([golden.drift, golden.flags.astype(np.int64), golden.hidden])
    actual = np.column_stack([trace.drift[0], trace.flags[0].astype(np.int64), trace.hidden[0]])
    mismatch = find_mismatch(model, expected.astype(np.int64), actual.astype(np.int64), labels)
    return None if mismatch is None else Failure("reference", "golden", mismatch)


def read_code(model: IntegerModel, folder: Path) -> GeneratedCode:
    """Return the C that lies in `folder`, with the harness that the model needs.

    Raises:
        InputError: a file is missing.
    """
    fresh = generate(model)
    texts = {}
    for name in (fresh.header_name, fresh.source_name):
        path = folder / name
        try:
            texts[name] = path.read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read ({error}). Run `zerodrift firmware`."
            ) from error
    return GeneratedCode(
        fresh.prefix, texts[fresh.header_name], texts[fresh.source_name], fresh.harness
    )
