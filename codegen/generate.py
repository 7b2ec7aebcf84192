"""Renders an integer model as one C header and one C source, deterministic to the byte."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import jinja2
import numpy as np

from zerodrift import __version__
from zerodrift.codegen.identifiers import sanitize_comment
from zerodrift.codegen.identity import PLACEHOLDER, find_runtime_identity, identify
from zerodrift.codegen.layouts import (
    crc_of_words,
    has_fast_kernels,
    lay_out_columns,
    lay_out_pairs,
    lay_out_row_biases,
    lay_out_rows,
)
from zerodrift.codegen.names import name_channels, name_outputs, name_prefix
from zerodrift.codegen.selftest import SELFTEST_SEED, SELFTEST_STEPS, compute_selftest, limits_of
from zerodrift.codegen.state import list_state, list_words
from zerodrift.codegen.tables import crc_of_tables, list_tables
from zerodrift.export.integer_model import FORMAT, IntegerModel
from zerodrift.operations.gru import IntegerGru
from zerodrift.operations.layers import IntegerGruStack
from zerodrift.operations.load import START_PASSES
from zerodrift.operations.network import IntegerGruLayer
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.total import IntegerSum

STATEFUL = ("lowpass", "delay", "play", "counter", "gru", "gru_stack")


@dataclass(frozen=True)
class GeneratedCode:
    """File names and texts of one model."""

    prefix: str
    header: str
    source: str
    harness: str
    """A host program's source that includes the model and runs it; never flashed."""
    runtime: Mapping[str, str] | None = None
    """The runtime's files beside it, by name; None for those of this version of zerodrift."""

    @property
    def header_name(self) -> str:
        """Name of the header, which the source includes."""
        return f"{self.prefix}.h"

    @property
    def source_name(self) -> str:
        """Name of the source."""
        return f"{self.prefix}.c"


def generate(model: IntegerModel) -> GeneratedCode:
    """Return the C of a model.

    Raises:
        CheckError: a bound of the model does not hold; an unproven model is never generated.
    """
    claims = model.prove()
    bounds = {bound.where: bound.interval for bound in claims}
    stateful = [n for n in model.nodes if n.kind in STATEFUL]
    layer = model.recurrent
    fed_at_rest = [n for n in stateful if n is not layer or layer.window]  # a cold GRU is 0
    needed_at_rest = _ancestors(model, fed_at_rest)
    settle_nodes = [n for n in model.nodes if layer and n.name in _ancestors(model, [layer])]
    selftest_low, selftest_high = limits_of(model)
    tables = list_tables(model)
    uses_tanh = any(_reads_tanh(node) for node in model.nodes)
    uses_exp2 = any(node.kind == "exp2" for node in model.nodes)
    prefix = name_prefix(model)
    context = {
        "model": model,
        "version": __version__,
        "format": FORMAT,
        "code_id": PLACEHOLDER,
        "runtime_id": find_runtime_identity(),
        "uses_tanh": uses_tanh,
        "uses_exp2": uses_exp2,
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "title": sanitize_comment(model.name),
        "channels": name_channels(model),
        "outputs": [name.upper() for name in name_outputs(model)],
        "guards": model.guards,
        "steps_full": max(model.guards.warm_up_steps, 1),
        "selftest_steps": SELFTEST_STEPS,
        "selftest_seed": SELFTEST_SEED,
        "selftest_crc": compute_selftest(model),
        "selftest_low": selftest_low,
        "selftest_high": selftest_high,
        "tables": tables,
        "tables_crc": crc_of_tables(tables),
        "checks": [
            *(f"{name}_is_sound" for name in _name_layers(layer)),
            *([f"{prefix}_tables_are_sound"] if tables else []),
            *(["zd_tanh_is_sound"] if uses_tanh else []),
            *(["zd_exp2_is_sound"] if uses_exp2 else []),
        ],
        "bounds": bounds,
        "claims": claims,
        "values": sum(max(node.width, 1) for node in model.nodes),
        "counts": any(n.kind == "counter" for n in model.nodes),
        "reads_inputs": any(n.kind in ("input", "load") for n in model.nodes),
        "code_type": f"{model.code_type.__name__}_t",
        "start_passes": START_PASSES,
        "state": list_state(model),
        "stateful": stateful,
        "rest_needed": needed_at_rest,
        "rest_nodes": [n for n in model.nodes if n in stateful or n.name in needed_at_rest],
        "settle_nodes": settle_nodes,
        "relax_reads_inputs": any(n.kind in ("input", "load") for n in settle_nodes),
    }
    environment = make_environment()
    header, source = identify(
        environment.get_template("model.h.j2").render(context),
        environment.get_template("model.c.j2").render(context),
    )
    return GeneratedCode(
        prefix=prefix,
        header=header,
        source=source,
        harness=environment.get_template("harness.c.j2").render(context),
    )


def _reads_tanh(node: IntegerNode) -> bool:
    """Return whether a node's step reads the runtime's table of tanh."""
    return isinstance(node, IntegerGruLayer) or getattr(node, "activation", "") == "tanh"


def _name_layers(layer: IntegerGruLayer | None) -> list[str]:
    """Return the C names of the recurrent layers, of which a stack has several."""
    if isinstance(layer, IntegerGruStack):
        return [f"{layer.name}_{level}" for level in range(len(layer.layers))]
    return [layer.name] if layer else []


def _ancestors(model: IntegerModel, of: list[IntegerNode]) -> set[str]:
    """Return the names of all nodes whose present values the nodes `of` need when they settle."""
    nodes = {node.name: node for node in model.nodes}
    found: set[str] = set()
    stack = [name for node in of for name in node.inputs]
    while stack:
        name = stack.pop()
        if name not in found:
            found.add(name)
            stack.extend(nodes[name].inputs)
    return found


@cache
def make_environment() -> jinja2.Environment:
    """Return the Jinja environment of all C templates."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("zerodrift.codegen", "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # the output is C; every free text in it is sanitised
    )
    environment.filters["comment"] = sanitize_comment
    environment.filters["numbers"] = format_numbers
    environment.filters["int32"] = format_int32
    environment.filters["int64"] = format_int64
    environment.filters["factor"] = format_factor
    environment.filters["total"] = format_sum
    environment.filters["by_unit"] = arrange_by_unit
    environment.filters["number"] = format_float
    environment.filters["words"] = list_words
    environment.filters["crc"] = crc_of_words
    environment.filters["has_fast_kernels"] = has_fast_kernels
    for layout in (lay_out_pairs, lay_out_columns, lay_out_rows, lay_out_row_biases):
        environment.filters[layout.__name__] = layout
    return environment


def format_numbers(values: Iterable[int], per_line: int = 12) -> str:
    """Return an initialiser list's inside, wrapped and indented by four spaces."""
    texts = [format_int32(int(v)) for v in values]
    lines = [texts[i : i + per_line] for i in range(0, len(texts), per_line)]
    return ",\n".join("    " + ", ".join(line) for line in lines)


def format_int32(value: int) -> str:
    """Return a C expression of type int for any int32 (the lowest has no literal)."""
    return "(-2147483647 - 1)" if value == -(2**31) else str(value)


def format_int64(value: int) -> str:
    """Return a C99 constant expression for any int64."""
    value = int(value)
    return f"(-INT64_C({2**63 - 1}) - 1)" if value == -(2**63) else f"INT64_C({value})"


def format_factor(value: int) -> str:
    """Return a C expression of type int64_t, to multiply an int32 with."""
    value = int(value)
    return f"(int64_t){value}" if -(2**31) < value < 2**31 else format_int64(value)


def format_sum(node: IntegerSum) -> str:
    """Return the C expression of a sum before it is limited, without operations that do nothing."""
    terms = [format_int64(node.bias)] if node.bias else []
    for coefficient, name in zip(node.coefficients, node.inputs, strict=True):
        terms.append(f"({format_factor(coefficient)} * {name})")
    text = " + ".join(terms)
    return f"zd_asr64({text}, {node.shift}u)" if node.shift else f"({text})"


def format_float(value: float) -> str:
    """Return a number for a comment: the shortest text that reads back the same."""
    return f"{value:.9g}"


def arrange_by_unit(gru: IntegerGru, field: str) -> list[int]:
    """Return a GRU array in the order of the C: unit by unit, within a unit gate by gate.

    [3, H, n] becomes [H][3][n], [4, H] and [3, H] become [H][4] and [H][3].
    """
    array: Any = getattr(gru, field)
    return [int(v) for v in np.moveaxis(array, 1, 0).ravel()]
