"""Reads a recurrent network from a float ONNX file, whoever wrote it.

The quantizer sees nothing of PyTorch or Keras: what is read here, by the ONNX definition of the
operators, is what reaches the chip. The graph is walked once from its inputs to its outputs; the
values on the way are those of `zerodrift.export.onnx_values`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, external_data_helper, numpy_helper

from zerodrift.base.errors import InputError, nearest
from zerodrift.export.float_network import FloatLayer, FloatNetwork
from zerodrift.export.importers import import_onnx
from zerodrift.export.onnx_cells import restore_cells
from zerodrift.export.onnx_operators import OPERATORS, OUTSIDE, REMEDIES, SUPPORTED, combine
from zerodrift.export.onnx_values import (
    RESHAPING,
    Axis,
    Constant,
    Fill,
    Moment,
    OnnxSignal,
    OnnxSource,
    RawInput,
    Refused,
    Unsupported,
    Value,
)
from zerodrift.operations.dense import FloatDense
from zerodrift.operations.layer_norm import FloatLayerNorm

# Builds a network in float64 from the values found in a float ONNX graph.


def build_network(signal: OnnxSignal) -> FloatNetwork:
    """Return the network of a graph's answer."""
    chain = signal.source.chain()
    inputs = next(source for source in chain if source.layer is None)
    layers = [source for source in chain if source.layer is not None]
    places = {id(inputs): 0} | {id(source): k for k, source in enumerate(layers, 1)}

    def order(source: OnnxSource) -> tuple[tuple[int, ...], list[int]]:
        """Return what a source is made of in ascending order, and its columns in that order."""
        singles = source.singles
        ends = np.cumsum([0, *(s.width for s in singles)])
        ascending = sorted(range(len(singles)), key=lambda i: places[id(singles[i])])
        columns = [c for i in ascending for c in range(ends[i], ends[i + 1])]
        return tuple(places[id(singles[i])] for i in ascending), columns

    found = []
    for source in layers:
        assert source.layer is not None and source.below is not None
        reads, columns = order(source.below)
        layer = source.layer
        if isinstance(layer, FloatDense):
            layer = replace(layer, weight=layer.weight[:, columns])
        elif not isinstance(layer, FloatLayerNorm):
            layer = replace(layer, w_x=layer.w_x[:, :, columns])
        found.append(FloatLayer(layer, reads))
    reads, columns = order(signal.source)
    return FloatNetwork(inputs.width, tuple(found), reads, signal.matrix[:, columns], signal.bias)


# Completes a float ONNX graph: weights in files beside it, and missing shapes.

LARGEST_FILE = 64 * 2**20
"""Bytes; the weights of a network that fits a microcontroller take a fraction of this."""


def load_external_data(model: onnx.ModelProto, where: str, folder: Path | None) -> None:
    """Read the weights that lie in other files beside the graph into it.

    Args:
        model: changed in place.
        where: the file's name, for messages.
        folder: where the files lie; None: there is none.

    Raises:
        InputError: a file is missing, too large, too short, or lies elsewhere; says the remedy.
    """
    tensors = [*model.graph.initializer]
    for nodes in (model.graph.node, *(f.node for f in model.functions)):
        tensors += [a.t for n in nodes for a in n.attribute if a.HasField("t")]
    outside = [t for t in tensors if t.data_location == TensorProto.EXTERNAL]
    if not outside:
        return
    remedy = (
        "Copy it there, or export again with the weights inside:"
        " torch.onnx.export(..., external_data=False)."
    )
    places = sorted({_find_location(t) for t in outside})
    if folder is None:
        raise InputError(f"{where}: keeps its weights in {places}, which are not at hand. {remedy}")
    for place in places:
        path = folder / place
        inside = path.resolve().is_relative_to(folder.resolve())
        if not place or Path(place).is_absolute() or not inside:
            raise InputError(
                f"{where}: keeps its weights in '{place}'; expected a file in its own folder."
                f" {remedy}"
            )
        try:
            size = path.stat().st_size
        except OSError as error:
            raise InputError(
                f"{where}: keeps its weights in the file '{place}' beside it, which cannot be read"
                f" ({error.strerror}). {remedy}"
            ) from error
        if size > LARGEST_FILE:
            raise InputError(
                f"{path}: has {size / 2**20:.0f} MiB; expected at most {LARGEST_FILE >> 20} MiB,"
                " since the network is to fit a microcontroller. Export the network alone."
            )
    for tensor in outside:
        try:
            external_data_helper.load_external_data_for_tensor(tensor, str(folder))
            tensor.data_location = TensorProto.DEFAULT
            numpy_helper.to_array(tensor)  # older versions of onnx read a file that is too short
        except Exception as error:  # onnx raises kinds of its own
            raise InputError(
                f"{where}: weight '{tensor.name}' cannot be read from '{_find_location(tensor)}'"
                f" beside it ({error}). Export both files again."
            ) from error
        del tensor.external_data[:]


def _find_location(tensor: onnx.TensorProto) -> str:
    return next((entry.value for entry in tensor.external_data if entry.key == "location"), "")


def complete_shapes(graph: onnx.GraphProto, where: str) -> None:
    """Give outputs without a type or a shape one, which nothing here reads; inputs need theirs.

    Raises:
        InputError: an input has no shape.
    """
    given = {tensor.name for tensor in graph.initializer}
    for value in graph.input:
        kind = value.type.tensor_type
        if value.name not in given and not kind.HasField("shape"):
            raise InputError(
                f"{where}: input '{value.name}' has no shape; expected its axes, of which only the"
                " features need a length. Export it again with example inputs."
            )
    for value in graph.output:
        kind = value.type.tensor_type
        if kind.elem_type == TensorProto.UNDEFINED:
            kind.elem_type = TensorProto.FLOAT
        if not kind.HasField("shape"):
            kind.shape.SetInParent()


# Computes nodes of a float ONNX graph whose inputs are all constants, within limits of size.

LARGEST = 2**24
"""Elements of a result; beyond it no network of a microcontroller is meant."""
ELEMENTWISE = frozenset(
    {"Add", "Sub", "Mul", "Div", "Pow", "Max", "Min", "Where", "Equal", "Less", "Greater"}
)
UNARY = frozenset(
    {
        "Neg",
        "Sqrt",
        "Reciprocal",
        "Exp",
        "Log",
        "Abs",
        "Cast",
        "Identity",
        "Transpose",
        "Reshape",
        "Squeeze",
        "Unsqueeze",
        "Flatten",
        "Slice",
        "Split",
        "Shape",
        "Concat",
        "ReduceMean",
        "ReduceSum",
        "Not",
    }
)
"""Their result is no larger than what they are given."""
PRODUCTS = frozenset({"Gather", "MatMul"})


def fold_constants(
    node: onnx.NodeProto, inputs: Sequence[NDArray[np.generic] | None]
) -> list[NDArray[np.generic]] | None:
    """Return a node's outputs, or None for an operator that is not computed here.

    Raises:
        Unsupported: the result would be too large, or the operator rejects its inputs.
    """
    if node.op_type not in ELEMENTWISE | UNARY | PRODUCTS or not inputs:
        return None
    given = [x for x in inputs if x is not None]
    if node.op_type in ELEMENTWISE:
        size = math.prod(np.broadcast_shapes(*(x.shape for x in given)))
    elif node.op_type == "Gather":
        size = given[0].size * max(given[1].size, 1)
    elif node.op_type == "MatMul":
        a, b = (x.shape if x.ndim > 1 else (1, *x.shape) for x in given)
        size = math.prod(np.broadcast_shapes(a[:-2], b[:-2])) * a[-2] * b[-1]
    else:
        size = sum(x.size for x in given)
    if size > LARGEST:
        raise Unsupported(f"its result would have up to {size} elements")
    from onnx.reference import ReferenceEvaluator

    names = {n: x for n, x in zip(node.input, inputs, strict=True) if n}
    try:
        return [np.asarray(y) for y in ReferenceEvaluator(node).run(None, names)]
    except Exception as error:
        raise Unsupported(f"it cannot be computed from its constants ({error})") from error


# Reads a recurrent network from a float ONNX file, whoever wrote it.

OLDEST_OPSET = 7
MOST_NODES = 100_000
"""Of a graph whose functions are unfolded."""


@dataclass(frozen=True)
class ImportedNetwork:
    """A network from an ONNX file, and how the file means it to be run."""

    network: FloatNetwork
    """On the graph's input as it is: any normalisation in the graph is folded into the weights."""
    steps: int
    """Samples of the sequence that the graph is made for; 0 for any number."""
    last_only: bool
    """Whether the graph gives an answer for the last sample only."""
    initial_state: str
    """"zero", "input" (the caller hands it over) or "constant" (other than zero)."""
    input_name: str
    output_name: str

    @property
    def window(self) -> int:
        """The window's length that the graph itself implies; 0 for a state that is carried on."""
        return self.steps if self.last_only and self.initial_state != "input" else 0


def read_imported(path: Path, output: str | None = None) -> ImportedNetwork:
    """Return the network of an ONNX file and how it is run.

    Args:
        path: the file; of another format where an installed package reads it.
        output: name of the graph output that is the drift; the only one that can be, if None.

    Raises:
        InputError: the file cannot be read, or holds something that has no fixed-point form here;
            names the node and what is supported.
    """
    imported = import_onnx(path)
    if imported is not None:
        return read_imported_bytes(imported, str(path), output)
    try:
        size = path.stat().st_size
        content = path.read_bytes() if size <= LARGEST_FILE else b""
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); expected an ONNX file."
        ) from error
    if size > LARGEST_FILE:
        raise InputError(
            f"{path}: has {size / 2**20:.0f} MiB; expected at most {LARGEST_FILE >> 20} MiB, since"
            " the network is to fit a microcontroller. Export the network alone."
        )
    return _read_graph(_parse(content, str(path), path.parent), str(path), output)


def read_imported_bytes(content: bytes, where: str, output: str | None = None) -> ImportedNetwork:
    """Return the network of an ONNX file's content; see `read_imported`."""
    return _read_graph(_parse(content, where), where, output)


def _parse(content: bytes, where: str, folder: Path | None = None) -> onnx.GraphProto:
    """Return the checked graph, functions inlined; weights in other files are read in `folder`."""
    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:  # protobuf raises its own kinds, without a common base
        raise InputError(f"{where}: cannot be read as ONNX ({error}). Export it again.") from error
    load_external_data(model, where, folder)
    if model.graph.sparse_initializer:
        raise InputError(f"{where}: holds sparse weights; expected dense ones. Export it again.")
    try:
        if model.functions:
            from onnx import inliner

            _check_inlined_size(model)
            model = inliner.inline_local_functions(model)
        complete_shapes(model.graph, where)
        onnx.checker.check_model(model)
    except InputError:
        raise
    except Exception as error:
        reason = str(error).strip().split("\n")[0]
        raise InputError(f"{where}: is no valid ONNX graph ({reason}). Export it again.") from error
    opsets = [o.version for o in model.opset_import if o.domain in ("", "ai.onnx")]
    if not opsets or opsets[0] < OLDEST_OPSET:
        raise InputError(
            f"{where}: uses opset {opsets[0] if opsets else 'none'}; expected {OLDEST_OPSET} or"
            " newer. Export it again."
        )
    restore_cells(model.graph, opsets[0])
    return model.graph


def _check_inlined_size(model: onnx.ModelProto) -> None:
    """Refuse functions that call themselves, or one another so often that the graph explodes.

    Raises:
        ValueError: either of them.
    """
    functions = {(f.domain, f.name): f for f in model.functions}
    sizes: dict[tuple[str, str], int] = {}

    def measure(nodes: Sequence[onnx.NodeProto], above: tuple[tuple[str, str], ...]) -> int:
        total = 0
        for node in nodes:
            key = (node.domain, node.op_type)
            if key in above:
                raise ValueError(f"function {node.op_type} calls itself")
            if key in functions and key not in sizes:
                sizes[key] = measure(functions[key].node, (*above, key))
            total += sizes.get(key, 1)
        return total

    total = measure(model.graph.node, ())
    if total > MOST_NODES:
        raise ValueError(f"its functions unfold to {total} nodes, over {MOST_NODES}")


@dataclass(frozen=True)
class _Walk:
    """What walking the graph found."""

    values: dict[str, Value]
    initial: dict[int, str]
    """id of a GRU's layer -> kind of its initial state."""


def _read_graph(graph: onnx.GraphProto, where: str, output: str | None) -> ImportedNetwork:
    walk = _walk(graph)
    name, signal = _choose_output(graph, walk.values, where, output)
    chain = signal.source.chain()
    recurrent = [s for s in chain if s.recurrent]
    if not recurrent:
        raise InputError(
            f"{where}: output '{name}' does not come from a GRU or an LSTM; {SUPPORTED}."
        )
    inputs = [s for s in chain if s.layer is None]
    if len(inputs) != 1:
        raise InputError(
            f"{where}: output '{name}' comes from the inputs {[s.name for s in inputs]}; expected"
            " one, with all signals along its last axis. Join them before the export."
        )
    times = [s.time for s in recurrent]
    if any(axis not in times and not axis.is_one for axis in inputs[0].last_along):
        raise InputError(
            f"{where}: output '{name}' takes the last entry of input '{inputs[0].name}' along an"
            " axis that is not the time. Leave that signal out of the input."
        )
    time = times[0]
    network = build_network(signal)
    _refuse_not_finite(network, where)
    kinds = {walk.initial[id(s)] for s in recurrent}
    return ImportedNetwork(
        network=network,
        steps=(time.size if time is not None else None) or 0,
        last_only=signal.last,
        initial_state=next((k for k in ("constant", "input") if k in kinds), "zero"),
        input_name=inputs[0].name,
        output_name=name,
    )


def _walk(graph: onnx.GraphProto) -> _Walk:
    """Return every value of the graph; what cannot be followed becomes `Refused`."""
    values: dict[str, Value] = {"": None}
    initial: dict[int, str] = {}
    for tensor in graph.initializer:
        values[tensor.name] = _read_tensor(tensor)
    for given in graph.input:
        if given.name not in values:
            values[given.name] = RawInput(given.name, _describe_axes(given))
    for node in graph.node:
        inputs = [values.get(name) for name in node.input]
        attributes = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
        results = _evaluate(node, attributes, inputs)
        values.update((n, v) for n, v in zip(node.output, results, strict=False) if n)
        for result in results[:1]:
            if node.op_type in ("GRU", "LSTM") and isinstance(result, OnnxSignal):
                initial[id(result.source)] = _tell_initial(inputs[5:7])
    return _Walk(values, initial)


def _read_tensor(tensor: onnx.TensorProto) -> Value:
    try:
        return Constant(numpy_helper.to_array(tensor))
    except (ValueError, TypeError, RuntimeError, MemoryError, KeyError) as error:
        return Refused(f"constant '{tensor.name}' cannot be read ({error})")


def _describe_axes(given: onnx.ValueInfoProto) -> tuple[Axis, ...]:
    dims = given.type.tensor_type.shape.dim
    return tuple(Axis(d.dim_value if d.dim_value > 0 else None) for d in dims)


def _evaluate(
    node: onnx.NodeProto, attributes: Mapping[str, Any], inputs: list[Value]
) -> list[Value]:
    """Return the values of a node's outputs."""
    name = f"{node.op_type} '{node.name or ', '.join(node.output)}'"
    outputs = len(node.output)
    refused = next((v for v in inputs if isinstance(v, Refused)), None)
    if refused is not None:
        return [refused] * outputs
    if node.op_type == "Constant" and "value" in attributes:
        return [_read_tensor(attributes["value"])]
    try:
        if node.domain not in ("", "ai.onnx"):
            raise Unsupported(f"an operator of {node.domain}")
        arrays = [v.array if isinstance(v, Constant) else None for v in inputs]
        if all(a is not None or v is None for a, v in zip(arrays, inputs, strict=True)):
            folded = fold_constants(node, arrays)
            if folded is not None:
                return list(map(Constant, folded))
        if node.op_type != "ReduceMean" and any(isinstance(v, Moment) for v in inputs):
            return combine(node, inputs)
        if node.op_type in RESHAPING and isinstance(inputs[0], Fill):
            return [inputs[0]] * outputs
        if node.op_type not in OPERATORS:
            remedy = REMEDIES.get(node.op_type)
            raise Unsupported(f"not supported: {remedy}" if remedy else "not supported")
        return OPERATORS[node.op_type](node, dict(attributes), inputs)
    except Unsupported as error:
        message = f"{name}: {error}"
    except (ValueError, IndexError, KeyError, TypeError, AttributeError, MemoryError) as error:
        message = f"{name}: cannot be followed ({error})"
    return [Refused(message)] * outputs


def _tell_initial(states: list[Value]) -> str:
    """Return the kind of a recurrent layer's initial states."""
    kinds = set[str]()
    for state in states:
        if state is None:
            kinds.add("zero")
        elif isinstance(state, Constant):
            kinds.add("constant" if state.array.any() else "zero")
        elif isinstance(state, Fill):
            kinds.add("constant" if state.value else "zero")
        else:
            kinds.add("input")
    return next((k for k in ("constant", "input") if k in kinds), "zero")


def _choose_output(
    graph: onnx.GraphProto, values: Mapping[str, Value], where: str, wanted: str | None
) -> tuple[str, OnnxSignal]:
    """Return the graph output that is the drift.

    A graph may give its states beside its answer; the answer is what is not a state.
    """
    names = [o.name for o in graph.output]
    if wanted is not None:
        if wanted not in names:
            raise InputError(
                f"{where}: has no output '{wanted}'{nearest(wanted, names)} It has {names}."
            )
        names = [wanted]
    found = {n: v for n in names if isinstance(v := values.get(n), OnnxSignal)}
    parts = [n for n in names if isinstance(values.get(n), Moment)]
    refused = [v for n in names if isinstance(v := values.get(n), Refused)]
    refused += [Refused(f"output '{n}': {OUTSIDE}") for n in parts]
    answers = {n: s for n, s in found.items() if not _is_state(s)}
    if not answers and refused:
        raise InputError(f"{where}: {refused[0].message}. {SUPPORTED[0].upper()}{SUPPORTED[1:]}.")
    tops = {n: s for n, s in found.items() if not _feeds_another(s, found)}
    candidates = answers or {n: s for n, s in tops.items() if not s.last} or tops
    if len(candidates) != 1:
        raise InputError(
            f"{where}: {len(candidates)} of the outputs {names} could be the drift"
            f" ({', '.join(candidates) or 'none comes from a recurrent layer'})."
            " Name one by --output."
        )
    return next(iter(candidates.items()))


def _is_state(signal: OnnxSignal) -> bool:
    """Tell whether a signal is the state of a recurrent layer itself.

    That of a minGRU whose candidate is a sigmoid is (1 + g) / 2 of the state g that is read.
    """
    identity = np.eye(signal.source.width)
    if not signal.source.recurrent or signal.matrix.shape != identity.shape:
        return False
    return any(
        (signal.matrix == scale * identity).all() and (signal.bias == 1.0 - scale).all()
        for scale in (1.0, 0.5)
    )


def _feeds_another(signal: OnnxSignal, found: Mapping[str, OnnxSignal]) -> bool:
    """Tell whether another output comes from the same states, further up."""
    others = [s for s in found.values() if s.source is not signal.source]
    return any(set(signal.source.singles) <= set(s.source.chain()) for s in others)


def _refuse_not_finite(network: FloatNetwork, where: str) -> None:
    """Refuse weights that are NaN or infinite."""
    for name, array in network.list_arrays():
        if not np.isfinite(array).all():
            at = [int(i) for i in np.argwhere(~np.isfinite(array))[0]]
            raise InputError(
                f"{where}: {name} has the value {array[tuple(at)]} at {at}; expected finite"
                " numbers. Train the network again."
            )
