"""The firmware's C as WebAssembly in Chromium: bits against the reference, and steps a second.

Each golden model runs a million steps in the page's own worker, in one go: drift and flags of every
step and the whole state after every 512 or so are compared with the integer reference.
"""

import sys
from collections.abc import Iterator
from statistics import median

import numpy as np
from tests.golden.models import CASES
from tests.golden.vectors import load

from benchmarks.bench_blocks import train_example
from benchmarks.bench_kernels import draw_fast_model
from benchmarks.chip_page import ChipPage, PlayedHost, open_chip_page
from zerodrift.base.errors import InputError
from zerodrift.c_runtime.wasm import FLAGS, build_wasm
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

STEPS, QUICK_STEPS, ROUNDS = 1_000_000, 20_000, 3
MARKS = {"lag bank": 5.0, "GRU(8)": 2.5, "GRU(16)": 0.8}
"""Million steps a second to be reached."""
WAYS = {"-Os": ("-Os",), "-O2": ("-O2",), "-O3": ("-O3",), "-O3 -msimd128": ("-O3", "-msimd128")}


def main(quick: bool) -> None:
    """Print differences, sizes and speeds; end with 1 where a bit differs."""
    steps = QUICK_STEPS if quick else STEPS
    try:
        with open_chip_page() as page:
            different = compare(page, steps)
            different += measure(page, steps, quick=quick)
    except InputError as error:
        print(f"not run: {error}")
        return
    if different:
        sys.exit(1)


def compare(page: ChipPage, steps: int) -> int:
    """Print each golden model's differences; return how many models differ."""
    different = 0
    print(f"golden models, {steps} steps each in one go, built with {' '.join(FLAGS)}, one thread")
    for name in CASES:
        different += print_model(page, name, load(name).model, steps, FLAGS)
    print(f"models that differ from the reference: {different} of {len(CASES)} (to reach 0)")
    return different


def measure(page: ChipPage, steps: int, *, quick: bool) -> int:
    """Print speed against the marks, each way of building; return how many differ."""
    different = 0
    for name, model in list_marked(quick=quick):
        for way, flags in WAYS.items():
            is_own = flags == FLAGS
            label = f"{name}, {way}{', as the page' if is_own else ''}"
            mark = MARKS[name] if is_own else None
            different += print_model(page, label, model, steps, flags, mark)
    return different


def list_marked(*, quick: bool) -> Iterator[tuple[str, IntegerModel]]:
    """Yield the models that have a mark; the lag bank is trained, which takes a while."""
    if not quick:
        yield "lag bank", train_example("lag_bank")
    yield "GRU(8)", draw_fast_model("int16", 8)
    yield "GRU(16)", draw_fast_model("int16", 16)


def print_model(
    page: ChipPage,
    name: str,
    model: IntegerModel,
    steps: int,
    flags: tuple[str, ...],
    mark: float | None = None,
) -> bool:
    """Print one model's line; return whether it differs."""
    codes = draw_codes(model, steps)
    wasm = build_wasm(generate(model), flags)
    played = page.play(model, wasm, codes, rounds=ROUNDS)
    check = check_host(PlayedHost(played), codes)
    largest = "0 LSB" if check.mismatch is None else f"DIFFERS: {check.mismatch}"
    if played.fault:
        largest += f"; SELF-TEST {played.fault}"
    speed, best = (len(codes) / pick(played.seconds) / 1e6 for pick in (median, min))
    told = "" if mark is None else f" (to reach {mark}: {'met' if speed >= mark else 'NOT met'})"
    speeds = f"{speed:5.2f} (best {best:.2f}) million steps a second"
    print(f"  {name:28} {largest}, {speeds}{told}, {len(wasm)} B", flush=True)
    return check.mismatch is not None or played.fault != 0


def draw_codes(model: IntegerModel, steps: int) -> CodeArray:
    """Return all random sequences [T, C], one after the other: noise, rails, jumps, walk, dwell."""
    return np.concatenate(list(draw_sequences(model, steps).values()))


if __name__ == "__main__":
    main("--quick" in sys.argv[1:])
