"""One program, a block per unit: sizes, cost, what the common format costs, what is accepted.

Units are simulated: the bundled example, trained here, and units whose parameters scatter
(`tests/blocks/units.py`; the seeds of the tests are others). Blocks are drawn from the design's
file by code that shares nothing with what writes and checks them; the program that they are run in
is built so that undefined behaviour ends it.
"""

import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from tests.blocks.draws import draw_admissible, list_inadmissible, read_design, write_block
from tests.blocks.flash import count_operations, cut_everywhere
from tests.blocks.test_blocks import DAY, make_block
from tests.blocks.units import LSB_K, PERIOD_S, describe_effects, describe_unit

from zerodrift.base.errors import InputError
from zerodrift.blocks.block import BlockNotes, apply, decode
from zerodrift.blocks.design import BlockDesign, make_design
from zerodrift.c_runtime.compilers import SANITIZE, can_sanitize, find_compiler
from zerodrift.c_runtime.emulator import EmulatedModel
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate, generate_design, generate_unit
from zerodrift.export.float_model import Calibration, FloatModel
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.quantize import quantize
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import evaluate
from zerodrift.verify.host_check import check_host
from zerodrift.verify.vectors import draw_sequences

CORE = "cortex-m4"
EXAMPLE = Path(__file__).parents[2] / "examples/ft40"
LIMITS_KB = {"none": 0.4, "lag_bank": 2.5, "gru": 3.5}
HIDDEN = 16
"""Units of the GRU in the place of the dense ones."""
KINDS = {
    "dense units": describe_unit,
    f"GRU of {HIDDEN} units": partial(describe_unit, hidden=HIDDEN),
    "2^x, play, delay, load": describe_effects,
}
"""What is in the blocks that are drawn."""
UNIT_SEEDS = range(10_000, 10_200)
BLOCK_SEEDS = range(50_000, 60_000)
WALK_STEPS = 3000
STEPS = 40
"""Of each drawn block."""
FINER = 1000
"""Counts per unit of outputs whose own rounding shall not hide the formats'."""


def main(quick: bool) -> None:
    """Print every mark of blocks with what was reached."""
    measure_example(("none",) if quick else ("none", "lag_bank", "gru"))
    for hidden in (0, HIDDEN):
        measure_formats(UNIT_SEEDS[:10] if quick else UNIT_SEEDS, hidden)
    count = 400 if quick else len(BLOCK_SEEDS)
    for kind in KINDS:
        measure_drawn(BLOCK_SEEDS[:count], kind)
    measure_cuts(2 if quick else 20)


def measure_example(kinds: tuple[str, ...]) -> None:
    """Print size and cost of the bundled example's block, for each kind of network."""
    for kind in kinds:
        model = train_example(kind)
        design = make_design([model])
        unit = design.fit(model)
        own = generate(model)
        code = generate_unit(design, unit, BlockNotes("SN0042", DAY, 1))
        size = len(code.block) / 1000
        print(f"block of the bundled example, {kind}: {size:.2f} KB (to reach {LIMITS_KB[kind]})")
        steps = [count_instructions(m, c) for m, c in ((model, own), (unit, code))]
        most = max(1.05 * steps[0], steps[0] + 12)
        print(f"  {CORE}, instructions a step: {steps[0]} with constants, {steps[1]} with the block"
              f" (to reach {most:.0f})")  # fmt: skip
        flash = [measure_footprint(c, CORE).flash_bytes for c in (own, code)]
        total, allowed = flash[1] + len(code.block), 1.05 * flash[0] + 800
        print(f"  {CORE}, flash: {flash[0]} B with constants; {flash[1]} B and a block of"
              f" {len(code.block)} B, {total} B in all (to reach {allowed:.0f})")  # fmt: skip


def train_example(kind: str) -> IntegerModel:
    """Return the integer model of the bundled example with another network."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "ft40"
        shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("build", "firmware", "logs"))
        toml = folder / "zerodrift.toml"
        text = toml.read_text(encoding="utf-8")
        unread = () if kind == "gru" else ("hidden", "memory")
        lines = [line for line in text.splitlines() if not line.startswith(unread)]
        toml.write_text(
            "\n".join(lines).replace('kind = "gru"', f'kind = "{kind}"'), encoding="utf-8"
        )
        for command in (("twin", "--example"), ("export",)):
            done = [sys.executable, "-m", "zerodrift", *command, "-C", str(folder)]
            subprocess.run(done, check=True, capture_output=True)
        return load_model(folder / "build/model.json")


def count_instructions(model: IntegerModel, code: GeneratedCode) -> int:
    """Return the most instructions that a step takes on the core."""
    with tempfile.TemporaryDirectory() as scratch:
        chip = EmulatedModel(model, code, CORE, Path(scratch))
        return max(chip.count_instructions(draw_sequences(model, 50)["walk"]))


def measure_formats(seeds: range, hidden: int) -> None:
    """Print how much further from the float model the common format is than each unit's own."""
    of = f"GRU of {hidden} units" if hidden else "dense units"
    for finer, what in ((1, "as delivered"), (FINER, f"outputs {FINER} times as fine")):
        units = [_refine(*describe_unit(seed, hidden=hidden), finer) for seed in seeds]
        own = [quantize(*unit) for unit in units]
        design = make_design(own)
        ratios = []
        for seed, (described, _), model in zip(seeds, units, own, strict=True):
            codes = draw_slow(seed)
            wanted = answer(described, codes)
            errors = [
                np.sqrt(np.mean((run(m, codes) - wanted) ** 2, axis=0))
                for m in (model, design.fit(model))
            ]
            ratios.append(float((errors[1] / errors[0]).max()))
        print(
            f"integer to float, common format over own, {of}, {len(seeds)} simulated units, worst"
            f" output of each, {what}: median {np.median(ratios):.3f} (to reach 1.2), worst"
            f" {max(ratios):.3f} (to reach 2)"
        )


def draw_slow(seed: int) -> np.ndarray:
    """Return codes [n, 1] so slow that no feature is limited, which would hide the formats."""
    rng = np.random.default_rng(seed)
    t, (slow, quick) = np.arange(WALK_STEPS) * PERIOD_S, rng.uniform(0, 2 * np.pi, 2)
    wave = 23 * np.sin(t * 2 * np.pi / 3000 + slow) + 1.2 * np.sin(t * 2 * np.pi / 400 + quick)
    noisy = 20 + wave + rng.normal(0, 0.01, WALK_STEPS)
    return np.round(noisy / LSB_K).astype(np.int16)[:, None]


def _refine(
    model: FloatModel, calibration: Calibration, finer: int
) -> tuple[FloatModel, Calibration]:
    outputs = tuple(replace(o, lsb_per_unit=o.lsb_per_unit * finer) for o in model.outputs)
    return replace(model, outputs=outputs), calibration


def answer(model: FloatModel, codes: np.ndarray) -> np.ndarray:
    """Return the float model's drift [n, K] in counts for codes [n, 1]."""
    inputs = {"temperature_degC": codes[:, 0] * LSB_K}
    nodes = [*model.features, *model.taps]
    values = np.stack(evaluate(nodes, inputs, PERIOD_S), axis=1)
    count = len(model.features)
    drift = model.offset + values[:, :count] @ model.coefficients
    if model.network is not None:
        assert model.whitening is not None and model.tap_mean is not None
        features = (values[:, count:] - model.tap_mean) @ model.whitening.T
        drift = drift + model.network.answer(features, 0)
    return np.asarray(drift * np.array([o.lsb_per_unit for o in model.outputs]))


def run(model: IntegerModel, codes: np.ndarray) -> np.ndarray:
    """Return the integer model's drift [n, K] in counts."""
    return Reference(model).run(codes[None]).drift[0]


def measure_drawn(seeds: range, kind: str) -> None:
    """Print how many drawn blocks overflow, differ or are wrongly accepted or refused."""
    arguments = [str(seeds.start), str(seeds.stop), kind]
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.bench_blocks", *arguments], check=False
    )
    if done.returncode:
        print(f"  the program ended with {done.returncode}: undefined behaviour, or a difference")


def run_drawn(seeds: range, of: str) -> None:
    """Run drawn blocks in a build that undefined behaviour ends, and print what was found."""
    describe = KINDS[of]
    design = make_design([quantize(*describe(seed)) for seed in UNIT_SEEDS[:50]])
    told = read_design(design.to_text())
    compiler = find_compiler()
    with tempfile.TemporaryDirectory() as scratch:
        guarded = can_sanitize(compiler, Path(scratch))
        flags = ("-O1", *(SANITIZE if guarded else ()))
        host = HostModel(
            design.model, generate_design(design), Path(scratch), compiler, flags, observe=False
        )
        differ = refused = 0
        for seed in seeds:
            content = write_block(told, draw_admissible(told, seed))
            if host.use_block(content):
                refused += 1
                continue
            host.model = apply(design, decode(design, content, "drawn"))
            sequences = draw_sequences(host.model, 5 * STEPS)
            codes = sequences[("noise", "rails", "jumps", "walk")[seed // 4 % 4]]
            differ += check_host(host, codes, settled=seed % 2 == 0).mismatch is not None
        accepted, tried = count_accepted(design, host, seeds.start, max(len(seeds) // 50, 1))
    kind = "undefined behaviour would have ended it" if guarded else "not built with sanitizers"
    print(
        f"drawn admissible blocks, {of}, {compiler.name}, {kind}: {len(seeds)} run for {STEPS}"
        f" steps, {differ} differ in a bit (95 %: at most {bound(differ, len(seeds)):.2g} of all),"
        f" {refused} refused"
    )
    print(
        f"inadmissible blocks, {of} (one number out by one, a norm above by one, cut, flipped bits,"
        f" endianness, format, design): {accepted} of {tried} accepted (95 %: at most"
        f" {bound(accepted, tried):.2g})"
    )


def count_accepted(design: BlockDesign, host: HostModel, seed: int, rounds: int) -> tuple[int, int]:
    """Return how many inadmissible blocks the chip or the tool accepts, and how many were tried."""
    told, accepted, tried = read_design(design.to_text()), 0, 0
    for k in range(rounds):
        for _, content in list_inadmissible(told, seed + k):
            tried += 1
            is_taken = host.use_block(content) == 0
            try:
                decode(design, content, "drawn")
                is_taken = True
            except InputError:
                pass
            accepted += is_taken
    return accepted, tried


def bound(found: int, of: int) -> float:
    """Return the one-sided 95 % Clopper-Pearson bound of a rate."""
    from scipy.stats import beta

    return float(beta.ppf(0.95, found + 1, of - found)) if found < of else 1.0


def measure_cuts(tears: int) -> None:
    """Print how often a cut of power leaves no sound block, or one that is not whole."""
    units = [quantize(*describe_unit(seed)) for seed in UNIT_SEEDS[:2]]
    design = make_design(units)
    model = design.fit(units[0])
    old, new = (make_block(design, model, number) for number in (1, 2))
    with tempfile.TemporaryDirectory() as scratch:
        host = HostModel(model, generate_design(design), Path(scratch))
        cuts = list(cut_everywhere(host, old, new, tears, seed=77))
    none = sum(chosen is None for chosen, _ in cuts)
    partly = sum(chosen is not None and not whole for chosen, whole in cuts)
    print(
        f"power cut at each of {count_operations(new)} erases and words of either slot, {tears}"
        f" values of what was torn, and again in the update that follows: {len(cuts)} starts,"
        f" {none} without a sound block, {partly} with one that is neither old nor new"
    )


if __name__ == "__main__":
    run_drawn(range(int(sys.argv[1]), int(sys.argv[2])), sys.argv[3])
