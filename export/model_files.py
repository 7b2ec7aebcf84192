"""Reads an integer model back from its file, and checks everything in it."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.records import from_json
from zerodrift.export.integer_model import FORMAT, OLDER_FORMAT, IntegerModel
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.node import ChannelNode, IntegerNode
from zerodrift.operations.registry import NODE_CLASSES

if TYPE_CHECKING:
    from zerodrift.export.integer_model import Channel, IntegerModel
    from zerodrift.operations.conversion import IntegerConversion


# Checks a model beyond its hash and the types of its fields: indices that exist, a proof.
#
# A hash shows that a file was not changed by accident; an editor of the file can compute a new one.


def check_model(where: str, model: "IntegerModel") -> None:
    """Refuse a model that no quantizer wrote.

    Raises:
        InputError: an index of something that is not there, or parts that do not fit together.
        CheckError: a bound of the arithmetic does not hold.
    """
    try:
        for index, channel in enumerate(model.channels):
            if channel.bits not in (16, 32):
                raise ValueError(f"channel '{channel.name}' has {channel.bits!r} bits")
            code = channel.no_reading
            if code is not None and not channel.least <= code <= channel.most:
                raise ValueError(f"channel '{channel.name}': {code} is no code")
            _check_conversion(index, model.channels)
        for node in model.nodes:
            _check_references(node, model)
        _check_whole(model)
        model.prove()
        _try_one_step(model)
    except CheckError:
        raise
    except (TypeError, ValueError, IndexError, KeyError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{where}: not built like an integer model ({error}). Run `zerodrift export`."
        ) from error


def _check_references(node: IntegerNode, model: "IntegerModel") -> None:
    """Raise where a node reads a channel or an output that is not there, or does not fit itself."""
    if node.reads not in (None, len(node.inputs)):
        raise ValueError(f"node '{node.name}' reads {len(node.inputs)} nodes, not {node.reads}")
    for name, count in (("channel", len(model.channels)), ("output", len(model.outputs))):
        index = getattr(node, name, 0)
        if not 0 <= index < count:
            raise IndexError(f"node '{node.name}' reads {name} {index} of {count}")
    if isinstance(node, ChannelNode):
        reach = 1 << (model.channels[node.channel].bits - 1)
        if not -reach <= node.low <= node.high < reach:
            raise ValueError(f"node '{node.name}' is limited to {node.low} .. {node.high}")
    node.check_form()


def _check_conversion(index: int, channels: "Sequence[Channel]") -> None:
    """Raise where a conversion is no table, or gives codes that its channel has not."""
    channel = channels[index]
    by = channel.conversion
    if by is None:
        return
    by.check_form()
    if by.channel != index or by.name != f"conversion_{index}" or by.inputs:
        raise ValueError(f"'{by.name}' stands at channel {index}")
    if by.junction is not None:
        _check_junction(by, by.junction, channels)
    if by.is_plain:
        if not (channel.least <= by.least and by.most <= channel.most and by.none is None):
            raise ValueError(f"'{by.name}': {channel.bits} bits do not hold {by.raw}")
    elif not channel.least <= by.lowest <= by.highest <= channel.most:
        raise ValueError(f"'{by.name}' gives {by.lowest} .. {by.highest}")
    elif by.none != channel.no_reading or (
        by.none is not None and by.lowest <= by.none <= by.highest
    ):
        raise ValueError(f"'{by.name}' means no reading by {by.none}")


def _check_junction(
    by: "IntegerConversion", cold: "IntegerConversion", channels: "Sequence[Channel]"
) -> None:
    """Raise where a thermocouple's cold junction is no channel that can be one."""
    if not 0 <= cold.channel < len(channels) or cold.channel == by.channel:
        raise IndexError(f"'{by.name}' has its cold junction at channel {cold.channel}")
    of = channels[cold.channel]
    if of.conversion is not None and of.conversion.junction is not None:
        raise ValueError(f"'{by.name}' has its cold junction at another thermocouple")
    if cold.raw != f"int{of.bits}" or cold.lacks != of.no_reading:
        raise ValueError(f"'{by.name}' reads its cold junction as {cold.raw}")


def _check_whole(model: "IntegerModel") -> None:
    """Raise where the parts of a model do not fit together."""
    _check_step(model)
    drift, guards = model.drift, model.guards
    count = len(model.outputs)
    lengths = {drift.width, len(drift.shift), len(drift.low), len(drift.high), drift.bias.size}
    lengths.add(drift.head_coefficients.size)
    if lengths != {count} or drift.coefficients.shape != (count, len(drift.signals)):
        raise ValueError(f"the drift has rows for {sorted(lengths)} outputs; there are {count}")
    if not 0 <= guards.temperature_channel < len(model.channels):
        raise IndexError(f"guards: channel {guards.temperature_channel} of {len(model.channels)}")
    for channel, low, high in guards.ranges:
        if not 0 <= channel < len(model.channels) or channel == guards.temperature_channel:
            raise IndexError(f"guards: a range of channel {channel}")
        if not model.channels[channel].least <= low <= high <= model.channels[channel].most:
            raise ValueError(f"guards: channel {channel} from {low} to {high}")
    thermometer = model.channels[guards.temperature_channel]
    for code in (guards.temperature_low, guards.temperature_high):
        if not -(2**31) <= code < 2**31:
            raise ValueError(f"guards: {code} is no code of '{thermometer.name}'")
    if not (0 <= guards.warm_up_steps < 2**31 and 0 <= guards.rate_max < 2**31):
        raise ValueError(f"guards: {guards.warm_up_steps} steps, {guards.rate_max} codes a step")
    if any(output.lsb_per_unit < 1 for output in model.outputs) or model.sample_period_s <= 0:
        raise ValueError("an output's lsb_per_unit or the sample period is not above 0")


def _check_step(model: "IntegerModel") -> None:
    """Raise where operations need steps of one length and have none, or the other way round."""
    for node in model.nodes:
        refused = node.needs_equal_steps if model.variable_step else node.needs_variable_step
        if refused:
            raise ValueError(f"'{node.name}' with variable_step = {model.variable_step}")
    if model.variable_step and (model.guards.warm_up_steps or model.period_us >= 2**32):
        raise ValueError("a variable step that warms up, or logs with a row in over an hour")


def _try_one_step(model: "IntegerModel") -> None:
    """Run the reference once: a vector where a number is read raises here."""
    from zerodrift.export.reference import Reference

    Reference(model).run(np.zeros((1, 1, model.columns), dtype=np.int64), settled=False)


# Reads an integer model back from its file, and checks everything in it.


def _read_nodes(bodies: object) -> Iterator[IntegerNode]:
    """Yield the nodes, each of the class that its `kind` names."""
    if not isinstance(bodies, list):
        raise ValueError(f"nodes: is {bodies!r:.40}; expected a list")
    seen: set[str] = set()
    for i, body in enumerate(bodies):
        where = f"nodes[{i}]"
        kind = body.get("kind") if isinstance(body, dict) else None
        if not isinstance(kind, str) or kind not in NODE_CLASSES:
            raise ValueError(f"{where}: unknown kind {kind!r}; expected one of {[*NODE_CLASSES]}")
        fields = {key: value for key, value in body.items() if key != "kind"}
        node = from_json(NODE_CLASSES[kind], fields, where, exact=True)
        missing = [name for name in node.inputs if name not in seen]
        if missing or node.name in seen:
            raise ValueError(f"{where}: '{node.name}' reads {missing}, which are not earlier nodes")
        seen.add(node.name)
        yield node


def load_model(path: Path) -> IntegerModel:
    """Read a model written by `IntegerModel.save`.

    Raises:
        InputError: no such file, not JSON, another format, fields missing or unknown, entries that
            do not fit their type, or a hash that does not match (the file was edited or damaged).
        CheckError: a bound of the arithmetic does not hold.
    """
    try:
        body = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{path}: there is no integer model. Run `zerodrift firmware`.") from error
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: cannot be read as a model ({error}). Run `zerodrift export`."
        ) from error
    return parse_model(str(path), body)


def parse_model(path: str, body: object) -> IntegerModel:
    """Return the model of a file's content, which is checked as `load_model` says.

    Args:
        path: names the file in messages.
        body: what its JSON holds.
    """
    if not isinstance(body, dict) or body.get("format") not in (OLDER_FORMAT, FORMAT):
        number = body.get("format") if isinstance(body, dict) else None
        found = f"a model of format {number}" if isinstance(number, int) else "no integer model"
        raise InputError(
            f"{path}: {found}; expected format {OLDER_FORMAT} or {FORMAT}, which this version of"
            " zerodrift reads. Run `zerodrift firmware` to build it again, or use the version that"
            " wrote it."
        )
    claimed = body.get("hash")
    fields = {key: value for key, value in body.items() if key not in ("format", "hash")}
    try:
        nodes = tuple(_read_nodes(body.get("nodes")))
        model = replace(from_json(IntegerModel, {**fields, "nodes": []}, exact=True), nodes=nodes)
        found = model.hash
    except (TypeError, AttributeError, ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: not built like an integer model ({error}). Run `zerodrift export`."
        ) from error
    if not model.nodes or not isinstance(model.nodes[-1], IntegerDrift):
        raise InputError(f"{path}: the last node is not 'drift'. Run `zerodrift export`.")
    if found != claimed:
        raise InputError(
            f"{path}: its hash is {found[:12]}, the file claims {str(claimed)[:12]}; it was"
            " edited or damaged. Run `zerodrift export`."
        )
    check_model(path, model)
    return model
