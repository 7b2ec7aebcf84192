"""A model file is read back as it was written, or refused with the reason."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.golden.model_factory import Shape, draw_model

from zerodrift.base.errors import InputError
from zerodrift.export.integer_model import FORMAT
from zerodrift.export.model_files import load_model
from zerodrift.export.reference import Reference

SHAPES = [
    Shape(front_end=("lowpass", "product", "delay", "difference", "power")),
    Shape(weights="int8", reset="before", window=3),
    Shape(hidden=0, name="Température */"),
]
Edit = Callable[[dict[str, Any]], object]


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A model file as the exporter writes it."""
    path = tmp_path / "model.json"
    draw_model(SHAPES[0], 4).save(path)
    return path


@pytest.mark.parametrize("shape", SHAPES, ids=["everything", "window", "unicode"])
def test_model_file_round_trip_is_equal(shape: Shape, tmp_path: Path) -> None:
    model = draw_model(shape, 5)
    model.save(tmp_path / "a.json")
    again = load_model(tmp_path / "a.json")
    again.save(tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert again.hash == model.hash
    assert again.prove() == model.prove()
    codes = np.random.default_rng(1).integers(-32768, 32768, size=(3, 40, shape.inputs))
    traces = [Reference(m).run(codes.astype(np.int16)) for m in (model, again)]
    np.testing.assert_array_equal(traces[0].drift, traces[1].drift)
    assert [p.name for p in tmp_path.iterdir() if p.suffix != ".json"] == []


def rehash(body: dict[str, Any]) -> None:
    """Give an edited body the hash it would have, so that only its content can be refused."""
    body["hash"] = "0" * 64


def find_node(body: dict[str, Any], kind: str) -> dict[str, Any]:
    return next(node for node in body["nodes"] if node["kind"] == kind)


def set_entry(kind: str, field: str, entry: object) -> Edit:
    return lambda body: find_node(body, kind)[field]["data"].__setitem__(0, entry)


EDITS: dict[str, tuple[Edit, str]] = {
    "one weight": (set_entry("head", "weights", 5), "edited or damaged"),
    "a limit": (lambda b: find_node(b, "input").update(low=-5), "edited or damaged"),
    "the sample period": (lambda b: b.update(sample_period_s=9.0), "edited or damaged"),
    "a guard": (lambda b: b["guards"].update(rate_max=1), "edited or damaged"),
    "another hash": (rehash, "edited or damaged"),
    "no hash": (lambda b: b.pop("hash"), "edited or damaged"),
    "another format": (lambda b: b.update(format=99), f"or {FORMAT}"),
    "unknown kind": (lambda b: find_node(b, "head").update(kind="heads"), "unknown kind 'heads'"),
    "field missing": (lambda b: find_node(b, "lowpass").pop("c_q24"), "expected the fields"),
    "field added": (lambda b: find_node(b, "lowpass").update(tau=1), "expected the fields"),
    "channels missing": (lambda b: b.pop("channels"), "lacks 'channels'"),
    "shape": (lambda b: find_node(b, "head")["weights"].update(shape=[2, 2]), "do not fill shape"),
    "negative shape": (lambda b: find_node(b, "head")["weights"].update(shape=[-1]), "shape"),
    "float dtype": (lambda b: find_node(b, "head")["weights"].update(dtype="float64"), "integers"),
    "too wide": (set_entry("head", "weights", 40_000), "does not fit int16"),
    "a float": (set_entry("head", "weights", 1.5), "do not fill"),
    "a NaN": (set_entry("head", "weights", float("nan")), "do not fill"),
    "a text": (set_entry("head", "weights", "1"), "do not fill"),
    "a boolean": (set_entry("head", "weights", True), "do not fill"),
    "an input from nowhere": (lambda b: find_node(b, "head").update(inputs=["gone"]), "gone"),
    "last node": (lambda b: b["nodes"].pop(), "last node is not 'drift'"),
    "no nodes": (lambda b: b.update(nodes=[]), "last node is not 'drift'"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_edited_model_file_is_refused(edit: str, saved: Path) -> None:
    change, told = EDITS[edit]
    body = json.loads(saved.read_text(encoding="utf-8"))
    change(body)
    saved.write_text(json.dumps(body), encoding="utf-8")
    with pytest.raises(InputError, match=told) as caught:
        load_model(saved)
    assert str(saved) in str(caught.value)


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_truncated_model_file_is_refused(keep: float, saved: Path) -> None:
    content = saved.read_bytes()
    saved.write_bytes(content[: int(len(content) * keep)])
    with pytest.raises(InputError, match="cannot be read as a model"):
        load_model(saved)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"[]", b"null", b"3", b'{"format": 2}'])
def test_file_that_is_no_model_is_refused(content: bytes, saved: Path) -> None:
    saved.write_bytes(content)
    with pytest.raises(InputError):
        load_model(saved)


@pytest.mark.parametrize(
    "edit",
    [
        lambda b: b.update(nodes={"a": 1}),
        lambda b: b.update(nodes=3),
        lambda b: b.update(nodes=[None]),
        lambda b: b.update(channels=3),
        lambda b: b.update(channels=[{}]),
        lambda b: b.update(outputs=None),
        lambda b: b.update(guards=[1]),
        lambda b: b.update(notes=3),
        lambda b: find_node(b, "gru").update(gru=None),
        lambda b: find_node(b, "gru").update(gru={"w_x": 1}),
        lambda b: find_node(b, "head").update(weights=None),
        lambda b: find_node(b, "head").update(weights={"dtype": "int16", "shape": 3, "data": []}),
        lambda b: find_node(b, "head").update(inputs=None),
        lambda b: find_node(b, "head").update(inputs=[["gru"]]),
        lambda b: find_node(b, "head").update(name=3),
        lambda b: find_node(b, "lowpass").update(c_q24=None),
    ],
)
def test_model_of_another_structure_is_refused(edit: Edit, saved: Path) -> None:
    body = json.loads(saved.read_text(encoding="utf-8"))
    edit(body)
    saved.write_text(json.dumps(body), encoding="utf-8")
    with pytest.raises(InputError):
        load_model(saved)


def test_missing_model_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no integer model"):
        load_model(tmp_path / "gone.json")


def test_hash_covers_everything_but_the_notes(saved: Path) -> None:
    model = load_model(saved)
    assert replace(model, notes={"from": "a test"}).hash == model.hash
    assert replace(model, name="other").hash != model.hash
    guards = replace(model.guards, rate_max=model.guards.rate_max + 1)
    assert replace(model, guards=guards).hash != model.hash
