"""The arithmetic, written a second time, against golden vectors and the reference."""

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.random_models import draw_case

from tests.fixed_point.test_mutated_models import write
from tests.frozen.projects import TOMLS, render_texts, write_project
from tests.oracle.layers import Recurrent
from tests.oracle.machine import Answer, Oracle
from tests.oracle.primitives import TANH_Q19
from tests.oracle.signals import OCTAVE_Q29
from tests.oracle.vector_file import compute_crc, read_vectors
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference
from zerodrift.operations.exp2 import OCTAVE_Q29 as REFERENCE_OCTAVE_Q29
from zerodrift.operations.tables import tanh_nodes

GOLDEN = Path(__file__).parent.parent / "golden"
NAMES = sorted(path.name.removesuffix(".model.json") for path in GOLDEN.glob("*.model.json"))

Codes = list[list[int]]


def get_hidden(oracle: Oracle, answer: Answer) -> list[int]:
    """Return what the recurrent nodes give, zeros while the state is new."""
    found: list[int] = []
    for name, unit in oracle.units.items():
        if isinstance(unit, Recurrent):
            hidden = answer.values.get(name, [0] * len(unit.h_q30[-1]))
            assert isinstance(hidden, list)
            found += hidden
    return found


@pytest.mark.spread(8, "name", NAMES)
def test_oracle_replays_golden_vectors(name: str) -> None:
    oracle = Oracle(GOLDEN / f"{name}.model.json")
    vectors = read_vectors(GOLDEN / f"{name}.vectors.json")
    if vectors.settled:
        oracle.settle(vectors.codes[0])
    rows = []
    for codes in vectors.codes:
        answer = oracle.step(codes)
        rows.append([*answer.drift, answer.flags, *get_hidden(oracle, answer)])
    assert rows[vectors.every - 1 :: vectors.every] == vectors.rows
    assert compute_crc(rows) == vectors.crc


def test_constants_are_those_of_the_reference() -> None:
    assert tanh_nodes().tolist() == TANH_Q19
    assert REFERENCE_OCTAVE_Q29 == OCTAVE_Q29
    assert len(NAMES) >= 14, "the golden models"


def list_edges(body: dict[str, Any], channel: int) -> list[int]:
    """Return the codes of a channel at which an input or a flag changes its mind."""
    guards = body["guards"]
    edges = [low_high for number, *low_high in guards.get("ranges", []) if number == channel]
    if channel == guards["temperature_channel"]:
        edges.append([guards["temperature_low"], guards["temperature_high"]])
    reading = [node for node in body["nodes"] if node["kind"] in ("input", "load")]
    edges += [[node["low"], node["high"]] for node in reading if node["channel"] == channel]
    return sorted({edge for pair in edges for edge in pair})


def draw_codes(body: dict[str, Any], steps: int, rng: random.Random) -> Codes:
    """Return any codes: noise, rails, edges of ranges, a walk, jumps of the largest rate."""
    columns, rate = [], body["guards"]["rate_max"]
    for number, channel in enumerate(body["channels"]):
        low, high = -(2 ** (channel["bits"] - 1)), 2 ** (channel["bits"] - 1) - 1
        edges = list_edges(body, number)
        way = rng.choice(["noise", "rails", "edges", "walk", "jumps"])
        column, here = [], rng.randint(edges[0], edges[-1])
        for _ in range(steps):
            if way == "noise":
                here = rng.randint(low, high)
            elif way == "rails":
                here = rng.choice([low, high])
            elif way == "edges":
                here = rng.choice(edges) + rng.randint(-1, 1)
            elif way == "walk":
                here += rng.randint(-1200, 1200)
            else:
                here += rng.choice([-1, 1]) * (rate + rng.randint(0, 1))
            here = min(max(here, low), high)
            gone = "no_reading" in channel and rng.random() < 0.2
            column.append(channel["no_reading"] if gone else here)
        columns.append(column)
    return [list(row) for row in zip(*columns, strict=True)]


def compare(
    model: IntegerModel, oracle: Oracle, sequences: list[Codes], starts: list[Codes]
) -> int:
    """Assert equal drifts, flags and values of all nodes; return the number of steps compared.

    Args:
        model: what the reference runs.
        oracle: the same model, read from its file.
        sequences: [B][T][C], all of one length.
        starts: [B][1][C], the codes of `settle`; empty: `init`.
    """
    reference, codes = Reference(model), np.array(sequences, dtype=np.int64)
    first = np.array([start[0] for start in starts]) if starts else codes[:, 0]
    state = reference.start(first, settled=bool(starts))
    wanted = []
    for step in range(codes.shape[1]):
        state, values, drift, flags = reference.step(state, codes[:, step])
        wanted.append((values, drift.tolist(), flags.tolist()))
    for index, sequence in enumerate(sequences):
        oracle.init()
        if starts:
            oracle.settle(starts[index][0])
        for step, row in enumerate(sequence):
            where = f"sequence {index}, step {step}"
            values, drifts, flags = wanted[step]
            answer = oracle.step(row)
            for name, value in answer.values.items():
                assert value == values[name][index].tolist(), f"{where}: {name}"
            assert answer.drift == drifts[index], where
            assert answer.flags == flags[index], where
    return codes.shape[0] * codes.shape[1]


def compare_at_random(name: str, cold: int, settled: int, steps: int, seed: int) -> None:
    """Compare sequences from `init`, and others from `settle` at codes of their own.

    A tenth of those from `init` are longer, so that they end the warm-up.
    """
    path = GOLDEN / f"{name}.model.json"
    body, model, oracle = json.loads(path.read_text()), load_model(path), Oracle(path)
    rng = random.Random(f"{name} {seed}")
    compare(model, oracle, [draw_codes(body, steps, rng) for _ in range(cold)], [])
    longer = steps + body["guards"]["warm_up_steps"]
    compare(model, oracle, [draw_codes(body, longer, rng) for _ in range(cold // 10)], [])
    sequences = [draw_codes(body, steps, rng) for _ in range(settled)]
    compare(model, oracle, sequences, [draw_codes(body, 1, rng) for _ in range(settled)])


@pytest.mark.spread(5, "name", NAMES)
def test_oracle_equals_reference_on_random_sequences(name: str) -> None:
    compare_at_random(name, cold=40 if name == "windowed" else 200, settled=8, steps=3, seed=0)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_oracle_equals_reference_on_many_random_sequences(name: str) -> None:
    compare_at_random(name, cold=400, settled=60, steps=12, seed=1)


def compare_random_model(number: int, sequences: int, steps: int, folder: Path) -> set[str]:
    """Compare a random model on its random signals; return the kinds of its nodes."""
    case = draw_case(17, number)
    case.model.save(folder / "model.json")
    oracle = Oracle(folder / "model.json")
    codes: list[Codes] = case.codes[:sequences, :steps].tolist()
    compare(case.model, oracle, codes, [row[:1] for row in codes] if case.settled else [])
    return {node["kind"] for node in oracle.nodes}


@pytest.mark.spread(3, "number", range(12))
def test_oracle_equals_reference_on_random_models(number: int, tmp_path: Path) -> None:
    compare_random_model(number, 1, 12, tmp_path)


@pytest.mark.slow
def test_oracle_equals_reference_on_many_random_models(tmp_path: Path) -> None:
    kinds: set[str] = set()
    for number in range(100, 200):
        kinds |= compare_random_model(number, 4, 60, tmp_path)
    assert kinds >= {"gru", "gru_stack", "dense", "lowpass", "delay", "play", "exp2", "power"}


@pytest.mark.parametrize("name", [*TOMLS, pytest.param("ft40", marks=pytest.mark.slow)])
def test_oracle_equals_reference_on_generated_models(name: str, tmp_path: Path) -> None:
    """Models as `zerodrift firmware` makes them, where the golden ones are drawn."""
    path, rng = tmp_path / "model.json", random.Random(name)
    path.write_text(render_texts(name, write_project(name, tmp_path / name))["model.json"])
    body, model, oracle = json.loads(path.read_text()), load_model(path), Oracle(path)
    sequences = [draw_codes(body, 20, rng) for _ in range(5)]
    compare(model, oracle, sequences, [])
    compare(model, oracle, sequences, [draw_codes(body, 1, rng) for _ in range(5)])


@pytest.mark.parametrize("activation", ["tanh", "clip"])
def test_oracle_equals_reference_without_a_gru(activation: str, tmp_path: Path) -> None:
    """`feature_dense`, which no golden model has, in the place of a golden model's GRU."""
    path = tmp_path / "model.json"
    write_dense_model(path, activation)
    body, rng = json.loads(path.read_text()), random.Random(activation)
    sequences = [draw_codes(body, 10, rng) for _ in range(20)]
    compare(load_model(path), Oracle(path), sequences, [])


def write_dense_model(path: Path, activation: str) -> None:
    """Write the golden front end with two dense layers."""
    body = json.loads((GOLDEN / "front_end.model.json").read_text())
    rng = random.Random(3)

    def make_layer(name: str, source: str, columns: int) -> dict[str, Any]:
        weights = [rng.randint(-9000, 9000) for _ in range(8 * columns)]
        clipped = activation == "clip"
        return {
            "activation": activation,
            "bias": {
                "data": [rng.randint(-(2**27), 2**27) for _ in range(8)],
                "dtype": "int32",
                "shape": [8],
            },
            "high": [rng.randint(8000, 32767) if clipped else 0 for _ in range(8)],
            "inputs": [source],
            "kind": "feature_dense" if source == "features" else "dense",
            "low": [rng.randint(-32768, 0) if clipped else 0 for _ in range(8)],
            "name": name,
            "shift": [11] * 8,
            "weights": {"data": weights, "dtype": "int16", "shape": [8, columns]},
        }

    (at,) = [i for i, node in enumerate(body["nodes"]) if node["kind"] == "gru"]
    body["nodes"][at : at + 1] = [make_layer("a", "features", 3), make_layer("b", "a", 8)]
    body["nodes"][at + 2]["inputs"] = ["b"]
    write(path, body)
