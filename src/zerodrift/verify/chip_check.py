"""The C on an emulated core, against the host's, which has been shown equal to the reference."""

import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.operations.arithmetic import CodeArray

CHIP_STEPS = 1000
"""Of each sequence; an emulated step takes a hundred times as long as the host's."""
COUNTED_STEPS = 4


@dataclass(frozen=True)
class ChipCheck:
    """What an emulated core gave."""

    core: str
    steps: int
    """Compared, each with all drifts and flags."""
    instructions_per_step: int
    """The largest number seen; the recurrent layer's share is the same for all data."""


def check_chip(
    core: str,
    code: GeneratedCode,
    host: HostModel,
    sequences: Mapping[str, CodeArray],
    folder: Path,
) -> ChipCheck | None:
    """Run the C on an emulated core; None if unicorn or a compiler for the core is missing.

    Args:
        core: one of `cores.list_emulated`.
        code: the model's C.
        host: the plain host build, already held against the reference.
        sequences: name -> raw codes [T, C].
        folder: is made, for sources and program.

    Raises:
        CheckError: a drift or flag differs from the host's, or the self-test fails; tells where.
    """
    if importlib.util.find_spec("unicorn") is None or not find_cross_compilers(core):
        return None
    from zerodrift.c_runtime.emulator import EmulatedModel

    folder.mkdir(parents=True, exist_ok=True)
    chip = EmulatedModel(host.model, code, core, folder)
    if chip.selftest() != 0:
        raise CheckError(f"{core}: the self-test fails on the emulated core. Nothing written.")
    steps = 0
    for name, whole in sequences.items():
        codes = whole[:CHIP_STEPS]
        expected = host.run(codes, settled=True)
        drift, flags = chip.run(codes, settled=True)
        different = (drift != expected.drift).any(axis=1) | (flags != expected.flags)
        if different.any():
            raise CheckError(
                f"{core}, sequence '{name}', step {int(np.argmax(different))}: drifts or flags"
                " differ from the host's. Nothing written."
            )
        steps += len(codes)
    first = next(iter(sequences.values()))[:COUNTED_STEPS]
    return ChipCheck(core, steps, max(chip.count_instructions(first)))
