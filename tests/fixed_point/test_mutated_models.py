"""Model files with anything changed anywhere: refused, or proven and generated like any other.

Each file is given the hash of its new content, so that it has to be refused for what it says.
"""

import copy
import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.certificate.test_check import list_texts
from tests.golden.model_factory import Shape, draw_model

from zerodrift.base.errors import ZerodriftError
from zerodrift.codegen.generate import generate
from zerodrift.export.model_files import load_model
from zerodrift.verify.certificate import certify
from zerodrift_proof.certificate.check import compare

pytestmark = pytest.mark.long

SHAPES = {
    "stack": Shape(
        inputs=2,
        hidden=3,
        outputs=2,
        front_end=("lowpass", "product", "root", "exp2", "play", "late", "clip", "warm_up", "load"),
        measured=(0,),
        upper=(2,),
        dense=((3, "relu6"), (2, "tanh")),
        weights="int8",
    ),
    "window": Shape(inputs=2, hidden=3, outputs=1, window=3, reset="before"),
}
VALUES: list[Any] = [
    *(0, 1, -1, 31, 63, 64, 255, 32768, -32769, 2**31, -(2**31) - 1, 2**53, 2**63, 2**64, 10**30),
    *(1.5, float("nan"), float("inf"), -0.0, 1e308, True, None, "", "x", "../../x", "*/", "\x00"),
    *([], {}, [[]], [0], {"dtype": "int16", "shape": [10**10], "data": []}),
    {"dtype": "int32", "shape": [2**40, 2**40], "data": [1]},
    {"dtype": "object", "shape": [1], "data": ["x"]},
]
Path_ = tuple[str | int, ...]


def list_places(body: Any, path: Path_ = ()) -> list[Path_]:
    """Return the place of everything in a body; of long lists of numbers, a few."""
    found = [path] if path else []
    if isinstance(body, dict):
        for key, value in body.items():
            found += list_places(value, (*path, key))
    elif isinstance(body, list):
        for i in range(len(body))[:: max(1, len(body) // 4)]:
            found += list_places(body[i], (*path, i))
    return found


def mutate(body: dict[str, Any], rng: np.random.Generator) -> str:
    """Change something anywhere; return what."""
    places = [p for p in list_places(body) if p[0] != "hash"]
    *way, last = places[rng.integers(len(places))]
    holder: Any = body
    for step in way:
        holder = holder[step]
    where = ".".join(map(str, (*way, last)))
    match rng.integers(5):
        case 0 if isinstance(holder, dict):
            del holder[last]
            return f"{where} deleted"
        case 0:
            holder.insert(last, copy.deepcopy(holder[last]))
            return f"{where} doubled"
        case 1 if type(holder[last]) is int:
            holder[last] += int(rng.choice([-1, 1]))
            return f"{where} moved by one"
        case 2 if type(holder[last]) is int:
            holder[last] = -holder[last]
            return f"{where} negated"
        case _:
            value = VALUES[rng.integers(len(VALUES))]
            holder[last] = copy.deepcopy(value)
            return f"{where} = {value!r:.40}"


def write(path: Path, body: dict[str, Any]) -> None:
    """Write a body with the hash that it has."""
    plain = {k: v for k, v in body.items() if k not in ("hash", "notes")}
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(text.encode()).hexdigest()
    path.write_text(json.dumps({**body, "hash": digest}), encoding="utf-8")


def check_mutations(shape: Shape, count: int, seed: int, path: Path) -> dict[str, int]:
    """Load and generate mutated models; count what became of them."""
    draw_model(shape, 3).save(path)
    whole = json.loads(path.read_text())
    write(path, whole)
    load_model(path)
    rng = np.random.default_rng(seed)
    outcomes = {"refused": 0, "proven": 0}
    for _ in range(count):
        body = copy.deepcopy(whole)
        what = mutate(body, rng)
        write(path, body)
        try:
            model = load_model(path)
            code = generate(model)
        except ZerodriftError as error:
            outcomes["refused"] += 1
            assert len(str(error)) > 20, what
            continue
        except Exception as error:
            raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
        outcomes["proven"] += 1
        outcome = compare(json.loads(certify(model, code)), list_texts(code))
        assert outcome.failures == (), f"{what}: {outcome.failures[:3]}"
    return outcomes


@pytest.mark.parametrize("name", SHAPES)
def test_mutated_model_is_refused_or_proven(name: str, tmp_path: Path) -> None:
    outcomes = check_mutations(SHAPES[name], 60, 1, tmp_path / "model.json")
    assert outcomes["refused"] >= 30 and outcomes["proven"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("seed", range(4))
def test_many_mutated_models_are_refused_or_proven(name: str, seed: int, tmp_path: Path) -> None:
    check_mutations(SHAPES[name], 500, 100 + seed, tmp_path / "model.json")
