"""A kernel's machine code on an emulated core, with any features and states: what it leaves."""

import random
from dataclasses import dataclass

from unicorn import UcError
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_R0,
    UC_ARM_REG_R4,
    UC_ARM_REG_SP,
)

from zerodrift.c_runtime.emulator import PAGE, make_chip
from zerodrift_proof.equality.kernels import CELL_LIMIT, H_LIMIT_Q30, Numbered
from zerodrift_proof.object.image import Image, Kernel

STATE, CELLS, FEATURES, STACK, STOP = (
    0x8000_0000,
    0x8001_0000,
    0x8002_0000,
    0x8004_0000,
    0x9000_0000,
)
LONGEST = 200_000
"""Instructions of a call."""


@dataclass(frozen=True)
class Given:
    """What a step is given."""

    x: tuple[int, ...]
    h: tuple[int, ...]
    c: tuple[int, ...]
    relaxing: bool


def draw_given(layer: Numbered, rng: random.Random) -> Given:
    """Return features and states: at the ends, near 0, anywhere."""

    def draw(limit: int) -> int:
        return rng.choice(
            (-limit, limit, 0, rng.randint(-9, 9), *(rng.randint(-limit, limit),) * 4)
        )

    return Given(
        tuple(max(-32768, min(32767, draw(32768))) for _ in range(layer.inputs)),
        tuple(draw(H_LIMIT_Q30) for _ in range(layer.hidden)),
        tuple(draw(CELL_LIMIT) for _ in range(layer.hidden if layer.kind == "lstm" else 0)),
        rng.random() < 0.3,
    )


class KernelChip:
    """An emulated core that holds a program's constants."""

    def __init__(self, core: str, image: Image, kernel: Kernel) -> None:
        """Load the program."""
        self.chip, self.kernel = make_chip(core), kernel
        pages = {
            page
            for span in image.spans
            for page in range(span.at // PAGE, (span.at + len(span.content)) // PAGE + 1)
        }
        for page in sorted(pages):
            self.chip.mem_map(page * PAGE, PAGE)
        for base in (STATE, CELLS, FEATURES, STOP):
            self.chip.mem_map(base, PAGE)
        self.chip.mem_map(STACK - 0x8000, 0x9000)
        self.write(image)

    def write(self, image: Image) -> None:
        """Take another program of the same layout."""
        for span in image.spans:
            self.chip.mem_write(span.at, span.content)
        self.chip.ctl_flush_tb()

    def run(self, given: Given, layer: Numbered) -> tuple[int, ...] | None:
        """Return what a call leaves in memory and registers; None where it is stopped."""
        chip, lstm = self.chip, layer.kind == "lstm"
        fenced = (*given.h, 0x5A5A5A5A), (*given.c, 0x5A5A5A5A)
        for base, values in zip((STATE, CELLS), fenced, strict=True):
            chip.mem_write(base, b"".join(v.to_bytes(4, "little", signed=True) for v in values))
        x = b"".join(v.to_bytes(2, "little", signed=True) for v in (*given.x, 0x5A5A))
        chip.mem_write(FEATURES, x)
        chip.mem_write(STACK - 0x1000, bytes(range(256)) * 16)
        chip.mem_write(STACK, int(given.relaxing).to_bytes(4, "little") + bytes(range(60)))
        mode = CELLS if lstm else (0 if given.relaxing else 0xFFFFFFFF)
        for k, value in enumerate((self.kernel.stream, STATE, FEATURES, mode)):
            chip.reg_write(UC_ARM_REG_R0 + k, value)
        for k in range(8):
            chip.reg_write(UC_ARM_REG_R4 + k, 0x1234567 * (k + 1))
        chip.reg_write(UC_ARM_REG_SP, STACK)
        chip.reg_write(UC_ARM_REG_LR, STOP | 1)
        try:
            chip.emu_start(self.kernel.at | 1, STOP, 0, LONGEST)  # type: ignore[call-arg]
        except UcError:
            return None
        if chip.reg_read(UC_ARM_REG_PC) & ~1 != STOP:
            return None
        kept = [chip.reg_read(UC_ARM_REG_R4 + k) for k in range(8)]
        kept.append(chip.reg_read(UC_ARM_REG_SP))
        memory = b"".join(
            bytes(chip.mem_read(at, size))
            for at, size in (
                (STATE, 4 * len(fenced[0])), (CELLS, 4 * len(fenced[1])),
                (FEATURES, len(x)), (STACK, 64),
            )
        )  # fmt: skip
        return (*kept, *memory)
