"""The tables of the assembly, laid out from the model by the proof and by the generator."""

import re

import pytest

from tests.golden.vectors import load
from tests.prove.models import as_read
from zerodrift.codegen.generate import generate
from zerodrift_proof.equality.rules import pack_assembly
from zerodrift_proof.equality.specification import Specification
from zerodrift_proof.equality.terms import Terms


@pytest.mark.parametrize(
    "name", ["ordinary", "odd_hidden", "reset_before", "int8", "lstm", "lstm_int8"]
)
def test_the_stream_of_each_layer_is_that_of_the_c(name: str) -> None:
    model = load(name).model
    source = generate(model).source
    layers = Specification(Terms(), as_read(model)).layers.layers
    assert layers
    for layer in layers.values():
        tables = re.findall(rf"{layer.name}_stream\[\d+\] = \{{[^\n]*\n([-\d,\s]*)\}}", source)
        streams = [[int(n) for n in table.split(",")] for table in tables]
        assert pack_assembly(layer)[0] in streams
