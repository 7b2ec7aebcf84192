"""Renders an integer model as one C header and one C source, deterministic to the byte."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import jinja2
import numpy as np

from zerodrift import __version__, operations
from zerodrift.blocks.block import BlockNotes, encode
from zerodrift.blocks.design import BlockDesign
from zerodrift.codegen.block_text import (
    describe_block,
    format_bound,
    list_held,
    mark,
    multiply,
    widen,
)
from zerodrift.codegen.identifiers import sanitize_comment
from zerodrift.codegen.identity import PLACEHOLDER, find_runtime_identity, identify
from zerodrift.codegen.inputs import describe_conversion
from zerodrift.codegen.names import name_channels, name_outputs, name_prefix
from zerodrift.codegen.node_text import NodeText
from zerodrift.codegen.selftest import SELFTEST_SEED, SELFTEST_STEPS, compute_selftest, limits_of
from zerodrift.codegen.state import list_state, list_words
from zerodrift.export.integer_model import FORMAT, IntegerModel
from zerodrift.operations.c_text import (
    crc_of_words,
    format_factor,
    format_int32,
    format_int64,
    format_numbers,
)
from zerodrift.operations.intervals import Bound
from zerodrift.operations.load import START_PASSES
from zerodrift.operations.node import ChannelNode, IntegerNode
from zerodrift.operations.registry import FILTERS
from zerodrift.operations.times import LONGEST_US


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
    design: BlockDesign | None = None
    """Of a program whose numbers lie in a block."""
    block: bytes = b""
    """A unit's block, which the harness computes with."""

    @property
    def named(self) -> tuple[str, int] | None:
        """The identity of a design's C, in place of a model's: hash and word of states."""
        return None if self.design is None else (self.design.identity, self.design.words[0] or 1)

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
    context: dict[str, object] = {
        "hash": model.hash,
        "identity": model.identity,
        "drift_ends": list(zip(model.drift.low, model.drift.high, strict=True)),
        "selftest_crc": compute_selftest(model),
    }
    return _render(model, model.prove(), limits_of(model), None, context)


def generate_unit(design: BlockDesign, model: IntegerModel, notes: BlockNotes) -> GeneratedCode:
    """Return the C of a design with a unit's block.

    Args:
        design: of the unit.
        model: the unit's, in the design's format (`BlockDesign.fit`).
        notes: serial, date and sequence.
    """
    return generate_design(design, encode(design, model, notes, compute_answers(design, model)))


def compute_answers(design: BlockDesign, model: IntegerModel) -> int:
    """Return the CRC of what a unit's self-test has to answer."""
    return compute_selftest(model, widen(design))


def generate_again(model: IntegerModel, code: GeneratedCode) -> GeneratedCode:
    """Return what is generated now of the model, or of the design and block, that C is of."""
    return generate(model) if code.design is None else generate_design(code.design, code.block)


def generate_design(design: BlockDesign, block: bytes = b"") -> GeneratedCode:
    """Return the C of a design: its program computes with whatever block it is given.

    Args:
        design: of the program.
        block: of a unit, which the harness computes with from the start; none if empty.

    Raises:
        CheckError: a bound does not hold for some block of the design's set.
    """
    low, high = design.answer_limits
    context: dict[str, object] = {
        "hash": design.identity,
        "identity": design.words[0] or 1,
        "drift_ends": [(low.low, high.high)] * len(design.model.outputs),
        "selftest_crc": 0,
        "block_words": np.frombuffer(block, dtype="<u8").tolist(),
        **describe_block(design),
    }
    widest = limits_of(widen(design))
    code = _render(mark(design), design.prove(), widest, design, context)
    return replace(code, design=design, block=block)


def _render(
    model: IntegerModel,
    claims: list[Bound],
    selftest_limits: tuple[list[int], list[int]],
    design: BlockDesign | None,
    further: Mapping[str, object],
) -> GeneratedCode:
    """Return the C.

    Args:
        model: the model; numbers of a block are the names of its fields.
        claims: what is proven of it.
        selftest_limits: lowest and highest code of each channel in the self-test.
        design: what its block is of; None: the model has none.
        further: what the templates are told beside that.
    """
    bounds = {bound.where: bound.interval for bound in claims}
    stateful = [n for n in model.nodes if n.stateful]
    streaming = [layer for layer in model.recurrents if layer.streams]
    fed_at_rest = [n for n in stateful if n not in streaming]  # cold recurrent layers are 0
    needed_at_rest = _ancestors(model, fed_at_rest)
    below = _ancestors(model, streaming)
    settle_nodes = [n for n in model.nodes if n.name in below or n in streaming]
    selftest_low, selftest_high = selftest_limits
    held = frozenset[str]() if design is None else list_held(design)
    every = (*model.conversions, *(n for n in model.nodes if n.name not in held))
    tables = [table for node in every for table in node.list_tables()]
    parts = sorted({part for node in model.nodes for part in node.parts})
    prefix = name_prefix(model)
    context: dict[str, object] = {
        "model": model,
        "version": __version__,
        "format": FORMAT,
        "code_id": PLACEHOLDER,
        "runtime_id": find_runtime_identity(),
        "headers": [
            *dict.fromkeys(part.header for part in parts),
            *(["zd_gru_pairs.h"] if any(layer.name in held for layer in model.recurrents) else []),
        ],
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "title": sanitize_comment(model.name),
        "channels": name_channels(model),
        "outputs": [name.upper() for name in name_outputs(model)],
        "guards": model.guards,
        "input_comments": [describe_conversion(channel) for channel in model.channels],
        "thermometer": model.channels[model.guards.temperature_channel],
        "steps_full": max(model.guards.warm_up_steps, 1),
        "selftest_steps": SELFTEST_STEPS,
        "selftest_seed": SELFTEST_SEED,
        "design": design,
        "held": held,
        "at": lambda node: "b->" if node.name in held else "",
        "selftest_low": selftest_low,
        "selftest_high": selftest_high,
        "tables": tables,
        "tables_crc": crc_of_words(word for table in tables for word in table.words),
        "checks": [
            *(
                f"{n}_is_sound"
                for layer in model.recurrents
                if layer.name not in held
                for n in layer.name_layers("_")
            ),
            *([f"{prefix}_tables_are_sound"] if tables else []),
            *dict.fromkeys(part.is_sound for part in reversed(parts)),
        ],
        "bounds": bounds,
        "claims": claims,
        "values": sum(max(node.width, 1) for node in model.nodes),
        "reads_inputs": any(isinstance(n, ChannelNode) for n in model.nodes),
        "code_type": f"{model.code_type.__name__}_t",
        "start_passes": START_PASSES,
        "longest_us": LONGEST_US,
        "reads_span": any(n.needs_variable_step for n in model.nodes),
        "state": list_state(model, of_block=design is not None),
        "stateful": stateful,
        "rest_nodes": [n for n in model.nodes if n in stateful or n.name in needed_at_rest],
        "settle_nodes": settle_nodes,
        "below": below,
        "relax_reads_inputs": any(isinstance(n, ChannelNode) for n in settle_nodes),
        **further,
    }
    environment = make_environment()
    text = NodeText(environment, context, bounds, needed_at_rest)
    context |= {"c": text, "counts": any(text.elapse(n) for n in model.nodes)}
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


def _ancestors(model: IntegerModel, of: Sequence[IntegerNode]) -> set[str]:
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
        loader=jinja2.ChoiceLoader(
            [
                jinja2.PackageLoader("zerodrift.codegen", "templates"),
                jinja2.FileSystemLoader(list(operations.__path__)),
            ]
        ),
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
    environment.filters["number"] = format_float
    environment.filters["words"] = list_words
    environment.filters["crc"] = crc_of_words
    environment.filters["bound"] = format_bound
    environment.filters["product"] = multiply
    environment.filters |= FILTERS
    return environment


def format_float(value: float) -> str:
    """Return a number for a comment: the shortest text that reads back the same."""
    return f"{value:.9g}"
