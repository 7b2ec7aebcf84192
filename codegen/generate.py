"""Renders an integer model as one C header and one C source, deterministic to the byte."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from dataclasses import fields as list_dataclass_fields
from functools import cache
from textwrap import wrap

import jinja2
import numpy as np
from jinja2.environment import TemplateModule

from zerodrift import __version__, operations
from zerodrift.base.column_config import ConversionConfig
from zerodrift.blocks.block import HEADER_BYTES, MAGIC, BlockNotes, encode, find_size
from zerodrift.blocks.design import FORMAT_OF_BLOCK, BlockDesign
from zerodrift.blocks.fields import C_TYPES, GUARDS, TYPES, FieldPlace, put
from zerodrift.blocks.gru import STREAM
from zerodrift.codegen.identifiers import name_channels, name_outputs, name_prefix, sanitize_comment
from zerodrift.codegen.identity import PLACEHOLDER, find_runtime_identity, identify
from zerodrift.codegen.selftest import SELFTEST_SEED, SELFTEST_STEPS, compute_selftest, limits_of
from zerodrift.export.encoding import find_held
from zerodrift.export.integer_model import FORMAT, Channel, Guards, IntegerModel
from zerodrift.operations.arithmetic import INT32_MIN
from zerodrift.operations.c_text import (
    FieldNumber,
    StateField,
    crc_of_words,
    format_factor,
    format_int32,
    format_int64,
    format_numbers,
)
from zerodrift.operations.intervals import Bound, Interval
from zerodrift.operations.load import START_PASSES
from zerodrift.operations.node import ChannelNode, IntegerNode
from zerodrift.operations.registry import FILTERS, FOLDERS
from zerodrift.operations.times import LONGEST_US

# A design's model for its C: every number that a block holds is replaced by its field's name.

TABLES = ("i16", "u8")
"""Types of fields that the C reads as tables, by an index."""


def mark(design: BlockDesign) -> IntegerModel:
    """Return the design's model with the names of fields in the place of numbers.

    It is for templates alone; nothing can be computed with it.
    """
    by_node: dict[str, list[FieldPlace]] = {}
    for field in design.fields:
        by_node.setdefault(field.place.node, []).append(field.place)
    nodes = tuple(_mark_node(n, by_node.get(n.name, [])) for n in design.model.nodes)
    guards = _mark_guards(design.model.guards)
    return replace(design.model, nodes=nodes, guards=guards)


def _mark_node(node: IntegerNode, places: list[FieldPlace]) -> IntegerNode:
    changed: dict[str, object] = {}
    for place in places:
        if place.attribute == STREAM:
            continue  # a layer's kernel reads it
        if place.name in {table.name for table in node.list_tables()}:
            continue  # read by an index
        if not place.sizes:
            changed[place.attribute] = FieldNumber(1, f"b->{place.name}")
            continue
        count = int(np.prod(place.sizes, dtype=np.int64))
        marks = [FieldNumber(1, f"b->{place.name}[{k}]") for k in range(count)]
        if isinstance(getattr(node, place.attribute), tuple):
            changed[place.attribute] = tuple(marks)
        else:
            marked = np.empty(count, dtype=object)
            marked[:] = marks
            changed[place.attribute] = marked.reshape(place.sizes)
    if not changed:
        return node
    known = {f.name for f in list_dataclass_fields(node)}
    assert changed.keys() <= known
    return replace(node, **changed)  # type: ignore[arg-type]  # by field names


def _mark_guards(guards: Guards) -> Guards:
    def field(name: str) -> FieldNumber:
        return FieldNumber(0, f"b->{name}")

    return replace(
        guards,
        temperature_low=field("temperature_low"),
        temperature_high=field("temperature_high"),
        rate_max=field("rate_max"),
        ranges=tuple(
            (channel, field(f"range_low[{k}]"), field(f"range_high[{k}]"))
            for k, (channel, _, _) in enumerate(guards.ranges)
        ),
    )


def list_held(design: BlockDesign) -> frozenset[str]:
    """Return the nodes whose tables, or a recurrent layer's numbers, lie in the block."""
    tables = {table.name: node.name for node in design.model.nodes for table in node.list_tables()}
    return frozenset(
        f.place.node for f in design.fields if f.place.name in tables or f.place.attribute == STREAM
    )


def widen(design: BlockDesign) -> IntegerModel:
    """Return the design's model with the widest limits that a block may have, for the self-test."""
    widest = {
        field.place: np.full(
            field.place.sizes,
            field.low if field.place.attribute.endswith("low") else field.high,
            dtype=np.int64,
        )
        for field in design.fields
        if field.place.node != GUARDS and field.place.attribute in ("low", "high")
    }
    return put(design.model, widest)


def describe_block(design: BlockDesign) -> Mapping[str, object]:
    """Return the variables of a block's templates."""
    used = HEADER_BYTES + 4
    used += sum(
        int(np.prod(f.place.sizes, dtype=np.int64)) * np.dtype(TYPES[f.place.type]).itemsize
        for f in design.fields
    )
    size = find_size(design)
    types = {f.place.type for f in design.fields}
    return {
        "block_bytes": size,
        "block_padding": size - used,
        "block_format": FORMAT_OF_BLOCK,
        "block_magic": MAGIC,
        "block_types": [kind for kind in TYPES if kind in types],
        "block_norms": any(f.norm for f in design.fields),
        "block_streams": any(f.pairs for f in design.fields),
        "field_types": C_TYPES,
    }


def format_bound(value: int, kind: str) -> str:
    """Return a bound of a field as an argument of its type."""
    if kind == "i64":
        return format_int64(value)
    if kind == "u8":
        return f"{value}u"
    return format_int32(max(value, INT32_MIN))


def multiply(sizes: tuple[int, ...]) -> int:
    """Return how many numbers a field has: 1 without sizes."""
    return int(np.prod(sizes, dtype=np.int64))


# The header's text on an input that the chip converts.

WIDTH = 76


def describe_conversion(channel: Channel) -> list[str]:
    """Return lines about an input with a table: codes, quantity, range, error, no reading."""
    by = channel.conversion
    if by is None or by.is_plain:
        return []
    unit = channel.unit
    low, high = find_held(channel)
    ends = (by.lowest, by.highest) if by.nodes[-1] >= by.nodes[0] else (by.highest, by.lowest)
    first, last = (f"{end * channel.lsb + channel.offset:.6g}" for end in ends)
    what = "codes" if by.junction is None else "sums of code and cold junction"
    told = [
        f"{channel.name}: {by.raw} codes of the hardware, {describe_formula(by.formula)}.",
        f"Converted to {channel.lsb:g} {unit} per count over {what} {by.low} .. {by.high}, which"
        f" are {first} to {last} {unit}, within {by.error:.3g} {unit}; beyond, the nearest of"
        " these.",
    ]
    if by.none is not None:
        told.append(f"No reading: {describe_missing(channel)}.")
    told.append(f"The codes that are readings stand for {low:.6g} to {high:.6g} {unit}.")
    if by.junction is not None:
        ends = (by.junction.low, by.junction.high)
        told.append(
            f"The cold junction counts within codes {ends[0]} .. {ends[1]} of its own; beyond, as"
            " the nearest of these."
        )
    if by.worth[1] > channel.lsb:
        told.append(
            f"One code is worth {by.worth[0]:.3g} to {by.worth[1]:.3g} {unit}, more than a count:"
            " the hardware resolves no finer there."
        )
    return [line for text in told for line in wrap(text, WIDTH)]


def describe_missing(channel: Channel) -> str:
    """Return in words which codes are no readings."""
    by = channel.conversion
    assert by is not None
    told = []
    if by.junction is not None:
        told = ["sums beyond the thermocouple's function", "a cold junction without a reading"]
        return " and ".join(told if by.lacks is None else [f"code {by.lacks}", *told])
    if by.begin > by.least:
        told.append(f"codes below {by.begin}")
    if by.end < by.most:
        told.append(f"codes above {by.end}")
    if by.lacks is not None and by.begin <= by.lacks <= by.end:
        told.append(f"code {by.lacks}")
    return " and ".join(told) or "no code"


def describe_formula(by: ConversionConfig) -> str:
    """Return in words what codes are converted by."""
    told = []
    if by.scale != 1.0 or by.offset:
        told.append(f"times {by.scale:g} plus {by.offset:g}")
    if by.divider is not None:
        side = "low" if by.divider.is_low else "high"
        told.append(
            f"a divider of {by.divider.counts:g} counts with {by.divider.series_ohm:g} ohm, the"
            f" sensor on the {side} side"
        )
    if by.kind == "ntc" and by.steinhart:
        told.append("a thermistor by Steinhart and Hart, " + ", ".join(map(repr, by.steinhart)))
    elif by.kind == "ntc":
        told.append(f"a thermistor of {by.r25_ohm:g} ohm at 25 degC, beta {by.beta_K:g} K")
    elif by.kind in ("pt100", "pt1000"):
        told.append(f"a {by.kind} (IEC 60751)")
    elif by.kind == "thermocouple":
        cold = (
            f"at {by.junction_degC:g} degC" if by.junction is None else f"measured by {by.junction}"
        )
        told.append(
            f"V of a thermocouple of type {by.couple} (IEC 60584-1), its cold junction {cold}"
        )
    elif by.kind == "table":
        told.append(f"a table of {len(by.points)} points")
    elif by.kind == "polynomial":
        told.append(f"a polynomial of degree {len(by.coefficients) - 1}")
    return "; ".join(told)


# The C of a model's nodes, one face after the other, from the operations' own folders.


class NodeText:
    """Renders nodes: a face is the macro of that name in `operations/FOLDER/c.j2`, if it is there.

    A class derived from another operation's takes what it lacks from there. Else a state is one
    number, at rest what the value is there, and sound within its bound.

    Args:
        environment: finds the templates.
        context: what a model's templates know.
        bounds: what is proven of each place in the model.
        needed_at_rest: names of the nodes whose values some state at rest is made from.
    """

    def __init__(
        self,
        environment: jinja2.Environment,
        context: Mapping[str, object],
        bounds: Mapping[str, Interval],
        needed_at_rest: Collection[str],
    ) -> None:
        self._environment, self._context = environment, context
        self._bounds, self._needed_at_rest = bounds, needed_at_rest
        self._macros: dict[str, TemplateModule | None] = {}

    def _render(self, face: str, node: IntegerNode) -> str:
        for kind in (c.__dict__["kind"] for c in type(node).__mro__ if "kind" in c.__dict__):
            macro = getattr(self._find_macros(FOLDERS[kind]), face, None)
            if macro is not None:
                return str(macro(node))
        return ""

    def _find_macros(self, folder: str) -> TemplateModule | None:
        if folder not in self._macros:
            try:
                template = self._environment.get_template(f"{folder}/c.j2")
            except jinja2.TemplateNotFound:
                self._macros[folder] = None
            else:
                self._macros[folder] = template.make_module(dict(self._context))
        return self._macros[folder]

    def constants(self, node: IntegerNode) -> str:
        """Return the tables."""
        return self._render("constants", node)

    def convert(self, node: IntegerNode) -> str:
        """Return how a raw code becomes that of its channel."""
        return self._render("convert", node)

    def functions(self, node: IntegerNode) -> str:
        """Return the functions that the node's step calls."""
        return self._render("functions", node)

    def claims(self, node: IntegerNode) -> str:
        """Return static assertions beside those of the certificate's bounds."""
        return self._render("claims", node)

    def sound(self, node: IntegerNode) -> str:
        """Return what sets `sound` to 0 where the state is not where the proof says it can be."""
        return self._render("sound", node) or "".join(
            self._ask_number(node, field) for field in node.list_state()
        )

    def _ask_number(self, node: IntegerNode, field: StateField) -> str:
        place, name = f"s->{field.name}", field.name.removeprefix(f"{node.name}_")
        bound, form = self._bounds[f"{node.name}.{name}"], format_int64 if field.bits > 32 else str
        beyond = f"({place} < {form(bound.low)}) || ({place} > {form(bound.high)})"
        return f"    if ({beyond}) {{\n        sound = 0u;\n    }}\n"

    def relax(self, node: IntegerNode) -> str:
        """Return how a recurrent layer comes to rest under the present input."""
        return self._render("relax", node)

    def copy(self, node: IntegerNode) -> str:
        """Return the int16 copy of a recurrent layer's present output."""
        return self._render("copy", node)

    def elapse(self, node: IntegerNode) -> str:
        """Return what the test harness does for a log that begins after power-on."""
        return self._render("elapse", node)

    def value(self, node: IntegerNode) -> str:
        """Return the value as a function of the inputs."""
        return self._render("value", node) or _declare(node, node.express())

    def settled(self, node: IntegerNode) -> str:
        """Return the value at rest."""
        return _declare(node, node.express_at_rest()) if node.stateful else self.value(node)

    def rest(self, node: IntegerNode) -> str:
        """Return the state at rest, and before it the value there if others need that."""
        if not node.stateful:
            return self.value(node)
        value = self.settled(node) if node.name in self._needed_at_rest else ""
        first, *_ = node.list_state()
        own = self._render("rest", node)
        return value + (own or f"    s->{first.name} = {node.express_at_rest()};\n")

    def step(self, node: IntegerNode) -> str:
        """Return the step: the value, and the state after it."""
        values = node.name if node.width else f"&{node.name}"
        return self._render("step", node) or (
            f"{self.value(node)}    ZD_OBSERVE({values}, {max(node.width, 1)}u);\n"
        )


def _declare(node: IntegerNode, expression: str) -> str:
    return f"    const int32_t {node.name} = {expression};\n"


# The fields of a model's state in C, and the words that a guard's checksum is taken over.

MOST_WRITTEN_OUT = 512
"""Numbers of a field up to which they stand in the checksum's lines one by one: up to 8 bytes of
flash and two instructions a word. Longer fields are summed up by the runtime's loops, which need a
quarter more for 32 bits and several times as much for rows of 16."""


def list_state(model: IntegerModel, *, of_block: bool = False) -> tuple[StateField, ...]:
    """Return the fields in their order in the struct.

    Args:
        model: the integer model.
        of_block: whether the state belongs to a block, which it then names.

    In a guarded state the wide ones come first. It has no gaps then but at its end, and its numbers
    of 16 bits begin at a whole word, so that a compiler loads two at once.
    """
    channels = name_channels(model)
    thermometer = model.guards.temperature_channel
    fields = [
        StateField(
            model.channels[thermometer].bits,
            "previous_temperature",
            comment="code of the step before",
        )
    ]
    if of_block:
        told = "CRC of the block that moves it on"
        fields.insert(0, StateField(32, "block", comment=told, unsigned=True))
    fields += [
        StateField(
            model.channels[k].bits, f"last_{channels[k]}", comment="for steps without a reading"
        )
        for k in model.held
    ]
    if model.variable_step:
        fields.append(StateField(64, "slept_us", comment="to add to the next step"))
    if model.tare:
        count = (len(model.outputs),)
        fields.append(StateField(32, "answered", count, "drift of the step before, from no tare"))
        fields.append(StateField(32, "tare", count, "drift that is taken off"))
        fields.append(StateField(32, "tared", comment="0: no answer yet; 1: answered; 2: tared"))
    if model.feeds_back:
        told = "of the step before: what was measured less this is the load"
        fields.append(StateField(32, "drift", (len(model.outputs),), told))
    for node in model.nodes:
        fields += node.list_state()
    return tuple(sorted(fields, key=lambda f: -f.bits) if model.guarded else fields)


def list_words(fields: tuple[StateField, ...]) -> Iterator[str]:
    """Yield statements in C that take every number of a state `s` into the sum `check` once."""
    halves: list[str] = []
    for field in fields:
        if len(field.elements) > MOST_WRITTEN_OUT:
            yield from _list_rows(field)
        elif field.bits == 64:
            yield f"check = zd_check_i64(check, s->{field.name});"
        elif field.bits == 32 and field.unsigned:
            yield f"check = zd_check_word(check, s->{field.name});"
        elif field.bits == 32:
            for element in field.elements:
                yield f"check = zd_check_number(check, s->{element});"
        else:
            halves += field.elements
    for low, high in zip(halves[::2], halves[1::2], strict=False):
        pair = f"(uint16_t)s->{low} | ((uint32_t)(uint16_t)s->{high} << 16)"
        yield f"check = zd_check_word(check, {pair});"
    if len(halves) % 2:
        yield f"check = zd_check_word(check, (uint16_t)s->{halves[-1]});"


def _list_rows(field: StateField) -> Iterator[str]:
    """Yield a loop of the runtime's over one long field."""
    *rows, length = field.sizes
    index = "[k]" if rows else ""
    line = f"check = zd_check_i{field.bits}(check, s->{field.name}{index}, {length}u);"
    if rows:
        yield f"for (uint32_t k = 0; k < {rows[0]}u; k++) {{"
        yield f"    {line}"
        yield "}"
    else:
        yield line


# Renders an integer model as one C header and one C source, deterministic to the byte.


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
