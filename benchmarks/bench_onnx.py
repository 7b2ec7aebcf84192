"""Reference, integer ONNX in onnxruntime and host C on random models: how many bits differ.

Run:  .venv/bin/python -m benchmarks bench_onnx [--quick]
      .venv/bin/python -m benchmarks.bench_onnx --count 2000 --seed 1
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from tests.golden.model_factory import FRONT_ENDS, Shape, draw_model

from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import IntArray
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences

FULL, QUICK = 2000, 20
STEPS = 250


def main(quick: bool) -> None:
    """Compare 2,000 random models, or 20."""
    compare(QUICK if quick else FULL, seed=1)


def compare(count: int, seed: int) -> bool:
    """Print how many values were compared and how many differed; tell whether none did."""
    began, values = time.perf_counter(), 0
    kinds: set[str] = set()
    differ = {"onnxruntime": 0, "host C": 0}
    for index in range(count):
        rng = np.random.default_rng((seed, index))
        model = draw_random(rng)
        kinds |= {node.kind for node in model.nodes}
        codes = np.stack(list(draw_sequences(model, STEPS).values()))
        settled = bool(rng.integers(2))
        expected = run_reference(model, codes, settled)
        values += expected.size
        found = {
            "onnxruntime": run_onnx(model, codes, settled),
            "host C": run_host(model, codes, settled, expected.shape[-1]),
        }
        for backend, rows in found.items():
            wrong = int((rows != expected).sum())
            differ[backend] += wrong
            if wrong:
                print(f"model {index} of seed {seed}: {backend} differs in {wrong} values")
        if sys.stderr.isatty() or index % 100 == 99:
            print(f"\r{index + 1} models", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print(
        f"{count} random models, {values} values: drift, flags, every node at every step and the"
        f" whole state at the end; kinds of nodes: {', '.join(sorted(kinds))}"
    )
    for backend, wrong in differ.items():
        print(f"{backend} against the reference: {wrong} values differ")
    print(f"{(time.perf_counter() - began) / count:.2f} s per model, compiling included")
    return not any(differ.values())


def draw_random(rng: np.random.Generator) -> IntegerModel:
    """Return a model of any shape that the tests' factory makes."""
    shape = Shape(
        inputs=int(rng.integers(1, 9)),
        hidden=int(rng.integers(0, 33)),
        outputs=(outputs := int(rng.integers(1, 17))),
        reset=str(rng.choice(["after", "before"])),
        weights=str(rng.choice(["int16", "int8"])),
        window=int(rng.choice([0, 0, 1, 2, 10])),
        front_end=tuple(rng.choice(FRONT_ENDS, size=rng.integers(0, 6)).tolist()),
        gain=float(rng.choice([0.1, 1.0, 5.0, 40.0])),
        update_bias=float(rng.choice([0.0, -4.0, -9.0])),
        code_limit=int(rng.choice([32768, 12000, 300])),
        drift_limit=float(rng.choice([1e9, 1e4, 20.0])),
        warm_up_steps=int(rng.choice([0, 1, 40])),
        measured=tuple(range(int(rng.integers(0, min(outputs, 3) + 1)))),
        upper=tuple(rng.integers(1, 13, size=rng.choice([0, 0, 1, 2])).tolist()),
        dense=tuple(
            (int(rng.integers(1, 13)), str(rng.choice(["tanh", "relu", "relu6"])))
            for _ in range(rng.choice([0, 0, 1, 2]))
        ),
    )
    return draw_model(shape, int(rng.integers(2**31)))


def run_reference(model: IntegerModel, codes: IntArray, settled: bool) -> IntArray:
    """Return all values [B, N] of the reference for codes [B, T, C]."""
    rows: list[IntArray] = []

    def keep(_: int, values: dict[str, IntArray]) -> None:
        rows.extend(values[node.name].reshape(len(codes), -1) for node in model.nodes)

    trace = Reference(model).run(codes, settled=settled, observe=keep)
    nodes = np.concatenate(rows, axis=1)
    return _join(trace.drift, trace.flags, nodes, trace.state.pack())


def run_onnx(model: IntegerModel, codes: IntArray, settled: bool) -> IntArray:
    """Return the same values of onnxruntime."""
    trace = OnnxModel(model).run(codes, settled=settled)
    return _join(trace.drift, trace.flags, trace.nodes, trace.state)


def run_host(model: IntegerModel, codes: IntArray, settled: bool, width: int) -> IntArray:
    """Return the same values, `width` per sequence, of the compiled C."""
    with tempfile.TemporaryDirectory() as scratch:
        host = HostModel(model, generate(model), Path(scratch), flags=("-O1",))
        rows = []
        for sequence in codes:
            trace = host.run(sequence, settled=settled)
            known = trace.drift.size + trace.flags.size + trace.nodes.size
            parts = (trace.drift, trace.flags, trace.nodes, host.pack(width - known))
            rows.append(np.concatenate([part.ravel().astype(np.int64) for part in parts]))
    return np.stack(rows)


def _join(*parts: IntArray) -> IntArray:
    return np.concatenate([p.reshape(len(p), -1).astype(np.int64) for p in parts], axis=1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=FULL, help="models")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    raise SystemExit(0 if compare(options.count, options.seed) else 1)
