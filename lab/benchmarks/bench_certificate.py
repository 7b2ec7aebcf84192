"""How tight the certificate is: what is observed against what is proven."""

import json
import re
import time
from collections import defaultdict

import numpy as np
from tests.certificate.test_check import build_files
from tests.fixed_point.accumulators import (
    prove_values,
    recompute,
    recompute_gru,
    record_sequences,
)
from tests.golden.model_factory import Shape, draw_model

from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.recurrent import H_LIMIT_Q30
from zerodrift_proof import compare

SHAPES = {
    "int16, 16 units": Shape(hidden=16, inputs=4),
    "int8, 16 units": Shape(hidden=16, inputs=4, weights="int8"),
    "reset before, window": Shape(hidden=16, inputs=4, reset="before", window=4),
    "saturating gates": Shape(hidden=16, inputs=4, gain=40.0),
    "front end": Shape(
        hidden=8, inputs=3, front_end=("lowpass", "product", "delay", "difference", "power")
    ),
}
Observed = dict[str, int]


def main(quick: bool) -> None:
    """Print observed / proven per kind of bound; fail if anything observed is beyond its bound.

    Inputs are noise, rails, jumps, a walk and a dwell over the whole int16 range; and, for each row
    of a gate alone, the features and states that are worst for it.
    """
    for name, shape in SHAPES.items():
        model = draw_model(shape, 3)
        certificate, texts = build_files(model)
        start = time.perf_counter()
        outcome = compare(json.loads(certificate), texts)
        seconds = time.perf_counter() - start
        if outcome.failures:
            raise SystemExit(f"{name}: {outcome.failures}")
        print(f"{name}: {outcome.holds} claims derived again in {seconds:.2f} s")
        seen = run(model, 1000 if quick else 20_000)
        worst = find_worst(model)
        ratios: dict[str, list[tuple[float, float]]] = defaultdict(list)
        for claim in json.loads(certificate)["bounds"]:
            where = claim["where"]
            bound = max(abs(claim["low"]), abs(claim["high"]))
            if where not in seen or bound == 0:
                continue
            adverse = max(seen[where], worst.get(where, 0))
            if adverse > bound:
                raise SystemExit(f"{name}: {where} reached {adverse}, proven is {bound}")
            kind = re.sub(r"\d+", "*", where)
            ratios[kind].append((seen[where] / bound, adverse / bound))
        for kind, pairs in ratios.items():
            runs, adverse = np.max(pairs, axis=0)
            print(f"  {kind:24} observed {100 * runs:5.1f} %, worst inputs {100 * adverse:5.1f} %")


def run(model: IntegerModel, steps: int) -> Observed:
    """Return the largest magnitude of every accumulator over all sequences."""
    seen: Observed = defaultdict(int)
    for where, found in recompute(model, record_sequences(model, steps)):
        seen[where] = max(seen[where], int(np.abs(found).max()))
    return seen


def find_worst(model: IntegerModel) -> Observed:
    """Return what each row of the GRU reaches under the features and states that are worst for it.

    Features and states are any within their proven ranges, whether a run gets there or not.
    """
    layer = model.recurrent
    seen: Observed = defaultdict(int)
    if layer is None:
        return seen
    gru = layer.gru
    ranges = prove_values(model)[layer.inputs[0]]
    low, high = (np.array([getattr(r, end) for r in ranges]) for end in ("low", "high"))
    if layer.window:  # what is stored may be any int16
        low, high = np.full_like(low, -32768), np.full_like(high, 32767)
    for gate in range(3):
        for unit in range(gru.hidden):
            for sign in (1, -1):
                x = np.where(sign * gru.w_x[gate, unit].astype(np.int64) >= 0, high, low)[None]
                h = sign * np.sign(gru.w_h[gate, unit].astype(np.int64))[None] * H_LIMIT_Q30
                found = recompute_gru(gru, layer.name, x.astype(np.int64), h.astype(np.int64))
                for where, value in found.items():
                    seen[where] = max(seen[where], int(np.abs(value).max()))
    return seen


if __name__ == "__main__":
    main(False)
