"""Layer normalisation: how far its integers are from float64, and the instructions of a step."""

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.c_runtime.emulator import EmulatedModel
from zerodrift.codegen.generate import generate
from zerodrift.export.quantize_layers import quantize_layer_norm
from zerodrift.operations.layer_norm import FloatLayerNorm

WIDTHS = (4, 5, 8, 16, 31, 64)
EPSILONS = (1e-3, 1e-5, 1e-8)
VECTORS = 100_000
"""For each width, the epsilons sharing them."""
MARK_PCT = 0.1
CORES = ("cortex-m4", "cortex-m0plus", "rv32imc")


def main(quick: bool) -> None:
    """Print every figure; `quick` draws fewer vectors."""
    print("integers against float64 of the same int16 numbers, RMS in % of the output's RMS;")
    print("spreads of the vectors from all of the range down to 1e-5 of it")
    for width in WIDTHS:
        errors = measure_width(width, VECTORS // (10 if quick else 1))
        worst = max(of_all for of_all, _ in errors)
        verdict = "reached" if worst <= MARK_PCT else "MISSED"
        told = ", ".join(
            f"{e:g}: {of_all:.2g}" for e, (of_all, _) in zip(EPSILONS, errors, strict=True)
        )
        print(
            f"  {width:3} wide, epsilon {told}; worst vector {max(w for _, w in errors):.2g} %"
            f" ({verdict}: {MARK_PCT})"
        )
    print_steps()


def measure_width(width: int, count: int) -> list[tuple[float, float]]:
    """Return for each epsilon the error in % of all vectors, and of the worst one."""
    rng = np.random.default_rng(width)
    found = []
    for epsilon in EPSILONS:
        layer = FloatLayerNorm(rng.uniform(-2, 2, width), rng.uniform(-1, 1, width), epsilon)
        node, own = quantize_layer_norm(layer, "norm", "h", np.full(width, 15))
        x = draw_vectors(rng, width, -(-count // len(EPSILONS)))
        y = node.step({}, {"h": x << 15})[1] * 2.0 ** -(own + 15)
        wanted = layer.step(x / 2.0**15)
        squares, of_output = ((y - wanted) ** 2).mean(axis=1), (wanted**2).mean(axis=1)
        of_all = 100.0 * np.sqrt(squares.mean() / of_output.mean())
        found.append((float(of_all), float(100.0 * np.sqrt(squares / of_output).max())))
    return found


def draw_vectors(rng: np.random.Generator, width: int, count: int) -> NDArray[np.int64]:
    """Return int16 vectors [count, width] whose numbers lie about a value, near or far."""
    spread = 10.0 ** rng.uniform(-5.0, 0.0, (count, 1))
    about = rng.uniform(-1.0, 1.0, (count, 1)) * (1.0 - spread)
    x = about + spread * rng.normal(size=(count, width))
    return np.clip(np.round(x * 2**15), -(2**15), 2**15 - 1).astype(np.int64)


def print_steps() -> None:
    """Print the instructions of a normalisation of 16 numbers, for rails, equal ones and noise."""
    print("instructions of a normalisation of 16 numbers, call included, clang")
    for core, flags in ((core, flags) for core in CORES for flags in ("-O2", "-Os")):
        counts = count_norms(core, flags)
        told = str(counts[0]) if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"
        print(f"  {core:13} {flags} {told}")


def count_norms(core: str, flags: str) -> list[int]:
    """Return the instructions of some normalisations of 16 numbers."""
    shape = Shape(inputs=2, layered=(("gru", 16, (0,)), ("norm", 16, (1,))), outputs=1)
    model, draw = draw_model(shape, 5), Draw(7)
    rows = [np.full(16, x) for x in (-32768, 0, 32767)]
    rows += [draw.codes(-(2**k), 2**k - 1, 16) for k in range(1, 16)]
    with tempfile.TemporaryDirectory() as folder:
        chip = EmulatedModel(model, generate(model), core, Path(folder), (flags,))
        return [chip.count_norm(row.astype(np.int16)) for row in rows]
