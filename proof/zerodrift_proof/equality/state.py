"""The fields of a model's state in the C, and what a sound state holds in them."""

from zerodrift_proof.equality.elapsed import LONGEST
from zerodrift_proof.equality.model import Model
from zerodrift_proof.equality.node import DRIFT, Ends, Field, State

__all__ = ["DRIFT", "State"]

IDENTITY, STEPS, PREVIOUS = "identity", "steps", "previous_temperature"
CHECK, SLEPT = "check", "slept_us"
ANSWERED, TARE, TARED = "answered", "tare", "tared"
"""Fields of the state that no node has."""


def count_warm_up(model: Model) -> int:
    """Return where the count of steps ends."""
    return max(model.guards.warm_up_steps, 1)


def list_fields(model: Model) -> list[Field]:
    """Return the fields of a model's state, in the order of the C."""
    channels, full = model.channel_names, count_warm_up(model)
    thermometer = model.guards.temperature_channel
    kinds = [f"int{channel.bits}_t" for channel in model.channels]
    fields = [Field(PREVIOUS, kinds[thermometer])]
    fields += [Field(f"last_{channels[k]}", kinds[k]) for k in model.held]
    if model.variable_step:
        fields.append(Field(SLEPT, "int64_t", (), 0, LONGEST))
    if model.tare:
        fields.append(Field(ANSWERED, "int32_t", (len(model.outputs),)))
        fields.append(Field(TARE, "int32_t", (len(model.outputs),)))
        fields.append(Field(TARED, "int32_t", (), 0, 2))
    if model.feeds_back:
        fields.append(Field(DRIFT, "int32_t", (len(model.outputs),)))
    ranges: dict[str, Ends] = {}
    for node in model.nodes:
        given = [ranges[name] for name in node.inputs]
        fields += node.list_fields(given)
        ranges[node.name] = node.bound(given)
    if model.guarded:
        fields.sort(key=lambda f: -int(f.type.strip("uint_")))
    first = [Field(IDENTITY, "uint32_t"), Field(STEPS, "uint32_t", (), 0, full)]
    last = [Field(CHECK, "uint32_t")] if model.guarded else []
    return [*first, *fields, *last]
