import numpy as np

from zerodrift.operations.backend import GraphOperations, NumpyOperations, evaluate
from zerodrift.operations.operation import list_nodes


def build_everything(ops, x, z):
    """Use every operation once."""
    slow = ops.lowpass(x, 12.0)
    slack = ops.difference(ops.play(x, 0.7), x)
    late = ops.delay(z, 2.5)
    bent = ops.power(ops.affine(z, 0.5, 1.0), 2.0)
    dark = ops.exp2(ops.clip(ops.affine(slow, 0.1, 0.0), -2.0, 2.0))
    return [
        ops.total(ops.product(slow, bent), ops.constant(3.0)),
        ops.total(slack, late),
        ops.product(dark, slow),
    ]


def draw_signals():
    rng = np.random.default_rng(0)
    return rng.normal(size=300).cumsum(), rng.normal(size=300)


def test_graph_equals_numpy():
    x, z = draw_signals()
    arrays = build_everything(NumpyOperations(0.5, x.shape), x, z)
    ops = GraphOperations(0.5)
    nodes = build_everything(ops, ops.input("x"), ops.input("z"))
    for node_value, array in zip(evaluate(nodes, {"x": x, "z": z}, 0.5), arrays, strict=True):
        assert (node_value == array).all()


def test_graph_shares_equal_nodes():
    ops = GraphOperations(1.0)
    x = ops.input("x")
    assert ops.lowpass(x, 5.0) is ops.lowpass(ops.input("x"), 5.0)
    assert ops.lowpass(x, 5.0) is not ops.lowpass(x, 5.1)


def test_graph_lists_inputs_before_uses_and_each_once():
    ops = GraphOperations(1.0)
    roots = build_everything(ops, ops.input("x"), ops.input("z"))
    order = list_nodes(roots)
    place = {id(node): i for i, node in enumerate(order)}
    assert len(place) == len(order)
    assert all(place[id(child)] < place[id(node)] for node in order for child in node.inputs)


def test_graph_prints_what_it_computes():
    ops = GraphOperations(1.0)
    assert repr(ops.lowpass(ops.input("temperature_degC"), 60.0)) == "lowpass(temperature_degC, 60)"
