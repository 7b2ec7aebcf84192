"""The larger and the smaller of two signals, in every format that signals come in."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.effects_on_chip.random_graphs import draw_codes
from tests.operations.everywhere import PERIOD_S, check_everywhere, derive_again, quantize_nodes
from tests.oracle.machine import Oracle

from zerodrift.c_runtime.cores import CORES
from zerodrift.codegen.generate import generate
from zerodrift.export.reference import Reference
from zerodrift.operations.backend import GraphOperations, NumpyOperations
from zerodrift.operations.operation import Node

LARGEST_ERROR = 2.0**-19
"""The format of the inputs, which no extremum makes coarser: 2**-12 of a code of 2**-7."""
ops = GraphOperations(PERIOD_S)
X, Y = ops.input("x0"), ops.input("x1")
RATE = ops.difference(X, ops.lowpass(X, 30.0))
CASES = {
    "of two inputs": (ops.maximum(X, Y), ops.minimum(X, Y)),
    "of one format": (ops.maximum(X, ops.delay(X, 4.0)), ops.minimum(X, ops.lowpass(X, 9.0))),
    "of falling scale": (
        ops.maximum(ops.affine(X, -1.0, 0.0), ops.affine(ops.delay(X, 3.0), -1.0, 0.0)),
        ops.minimum(ops.affine(X, -0.3, 5.0), Y),
    ),
    "with a constant": (
        ops.maximum(RATE, ops.constant(0.0)),
        ops.minimum(ops.constant(-0.5), RATE),
        ops.maximum(ops.constant(2.0), ops.constant(3.0)),
    ),
    "of unequal sizes": (
        ops.maximum(ops.affine(ops.product(X, X), 0.02, 0.0), Y),
        ops.minimum(ops.affine(Y, 1e-3, 0), X),
    ),
    "of each other": (ops.minimum(ops.maximum(RATE, ops.affine(RATE, -0.5, 0.0)), Y),),
}


@pytest.mark.parametrize("name", CASES)
def test_an_extremum_is_the_same_everywhere(name: str, tmp_path: Path) -> None:
    cores = ["cortex-m0plus"] if name == "of two inputs" else []
    model = check_everywhere(CASES[name], tmp_path, LARGEST_ERROR, cores)
    limits = {"clip", "drift", "input", "lowpass", "difference"}
    kinds = {node.kind for node in model.nodes}
    assert kinds <= limits if name == "with a constant" else kinds & {"maximum", "minimum"}


@pytest.mark.slow
@pytest.mark.parametrize("core", CORES)
def test_an_extremum_is_the_same_on_a_core(core: str, tmp_path: Path) -> None:
    check_everywhere(CASES["of two inputs"], tmp_path, LARGEST_ERROR, cores=[core])


@pytest.mark.parametrize("node", CASES["of two inputs"], ids=["maximum", "minimum"])
def test_the_checker_takes_no_other_comparison(node: Node) -> None:
    model = quantize_nodes([node])
    code, (a, b) = generate(model), model.nodes[-2].inputs
    right, wrong = (">", "<") if model.nodes[-2].kind == "maximum" else ("<", ">")
    for other in (f"({a} {wrong} {b}) ? {a} : {b}", f"({a} {right} {b}) ? {b} : {a}"):
        mixed_up = code.source.replace(f"({a} {right} {b}) ? {a} : {b}", other)
        assert mixed_up != code.source
        outcome = derive_again(model, replace(code, source=mixed_up))
        assert any(f"{model.nodes[-2].name}: claimed" in text for text in outcome.failures)


def test_the_second_implementation_says_the_same(tmp_path: Path) -> None:
    model = quantize_nodes(CASES["of each other"])
    model.save(tmp_path / "model.json")
    oracle, codes = Oracle(tmp_path / "model.json"), draw_codes(9)
    drift = Reference(model).run(codes[None], settled=False).drift[0].tolist()
    assert [oracle.step(row).drift for row in codes.tolist()] == drift


def test_an_extremum_of_a_signal_and_itself_is_that_signal() -> None:
    model = quantize_nodes([ops.maximum(X, ops.affine(X, 1.0, 0.0))])
    assert {node.kind for node in model.nodes} == {"input", "drift"}


def test_formats_are_shared_only_where_they_have_to_be() -> None:
    def kinds_of(node: Node) -> list[str]:
        return [n.kind for n in quantize_nodes([node]).nodes]

    assert kinds_of(ops.maximum(X, ops.delay(X, 4.0))) == ["input", "delay", "maximum", "drift"]
    assert kinds_of(ops.maximum(X, Y)).count("sum") == 2


def test_an_effect_calls_it_on_arrays() -> None:
    arrays = NumpyOperations(1.0, (3,))
    a, b = np.array([1.0, 2.0, 3.0]), np.array([3.0, 2.0, 1.0])
    assert arrays.maximum(a, b).tolist() == [3.0, 2.0, 3.0]
    assert arrays.minimum(a, b=b).tolist() == [1.0, 2.0, 1.0]
    with pytest.raises(TypeError, match=r"maximum\(a, b\)"):
        arrays.maximum(a)
