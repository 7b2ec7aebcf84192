"""The fields of a model's state in the C, and what a sound state holds in them."""

from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift.codegen.names import name_channels
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.counter import IntegerCounter
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.elapsed import IntegerElapsed
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.intervals import Interval
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.operations.lstm import IntegerLstmLayer
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.play import IntegerPlay
from zerodrift.verify.prove_elapsed import LONGEST
from zerodrift.verify.prove_kernels import CELL_LIMIT, H_LIMIT_Q30
from zerodrift.verify.prove_terms import Whole

State = dict[str, list[Whole]]
"""Field of the C's state -> its numbers."""
IDENTITY, STEPS, PREVIOUS = "identity", "steps", "previous_temperature"
DRIFT, CHECK, SLEPT = "drift", "check", "slept_us"
ANSWERED, TARE, TARED = "answered", "tare", "tared"
"""Fields of the state that no node has."""


@dataclass(frozen=True)
class Field:
    """A field of the state."""

    name: str
    type: str
    sizes: tuple[int, ...] = ()
    low: int | None = None
    """What a sound state holds there; None: anything."""
    high: int | None = None

    @property
    def count(self) -> int:
        """How many numbers it holds."""
        count = 1
        for size in self.sizes:
            count *= size
        return count


def count_warm_up(model: IntegerModel) -> int:
    """Return where the count of steps ends."""
    return max(model.guards.warm_up_steps, 1)


def list_fields(model: IntegerModel) -> list[Field]:
    """Return the fields of a model's state, in the order of the C."""
    channels = name_channels(model)
    full = count_warm_up(model)
    bounds = {bound.where: bound.interval for bound in model.prove()}
    thermometer = model.guards.temperature_channel
    kinds = [f"int{channel.bits}_t" for channel in model.channels]
    fields = [Field("previous_temperature", kinds[thermometer])]
    fields += [Field(f"last_{channels[k]}", kinds[k]) for k in model.held]
    if model.variable_step:
        fields.append(Field(SLEPT, "int64_t", (), 0, LONGEST))
    if model.tare:
        fields.append(Field(ANSWERED, "int32_t", (len(model.outputs),)))
        fields.append(Field(TARE, "int32_t", (len(model.outputs),)))
        fields.append(Field(TARED, "int32_t", (), 0, 2))
    if model.feeds_back:
        fields.append(Field("drift", "int32_t", (len(model.outputs),)))
    for node in model.nodes:
        fields += _list_own(node, bounds)
    if model.guarded:
        fields.sort(key=lambda f: -int(f.type.strip("uint_")))
    first = [Field("identity", "uint32_t"), Field("steps", "uint32_t", (), 0, full)]
    last = [Field("check", "uint32_t")] if model.guarded else []
    return [*first, *fields, *last]


def _list_own(node: IntegerNode, bounds: Mapping[str, Interval]) -> list[Field]:
    name = node.name
    match node:
        case IntegerLowpass():
            v = bounds[f"{name}.v"]
            return [Field(f"{name}_v", "int64_t", (), v.low, v.high)]
        case IntegerLowpassAfter():
            own = [("before", "int32_t"), ("waiting", "int32_t"), ("y", "int64_t")]
            ranges = [bounds[f"{name}.{part}"] for part, _ in own]
            return [
                Field(f"{name}_{part}", kind, (), x.low, x.high)
                for (part, kind), x in zip(own, ranges, strict=True)
            ]
        case IntegerElapsed():
            return [Field(f"{name}_time", "int64_t", (), 0, node.most_us)]
        case IntegerPlay():
            y = bounds[f"{name}.y"]
            return [Field(f"{name}_y", "int32_t", (), y.low, y.high)]
        case IntegerCounter():
            return [Field(f"{name}_count", "int32_t", (), 0, node.limit)]
        case IntegerDelay():
            x = bounds[f"{name}.line"]
            return [
                Field(f"{name}_line", "int32_t", (node.steps,), x.low, x.high),
                Field(f"{name}_oldest", "uint16_t", (), 0, node.steps - 1),
            ]
        case IntegerGruLayer() | IntegerLstmLayer() if node.window:
            inputs = node.layers[0].inputs
            return [
                Field(f"{name}_window", "int16_t", (node.window, inputs)),
                Field(f"{name}_oldest", "uint16_t", (), 0, node.window - 1),
            ]
        case IntegerGruLayer():
            hidden = [layer.hidden for layer in node.layers]
            limit = H_LIMIT_Q30
            fields = [Field(f"{name}_h_q30", "int32_t", (hidden[-1],), -limit, limit)]
            if len(hidden) > 1:
                lower = (sum(hidden[:-1]),)
                fields.append(Field(f"{name}_lower_q30", "int32_t", lower, -limit, limit))
            return fields
        case IntegerLstmLayer():
            units = (sum(layer.hidden for layer in node.layers),)
            return [
                Field(f"{name}_cell", "int32_t", units, -CELL_LIMIT, CELL_LIMIT),
                Field(f"{name}_h_q30", "int32_t", units, -H_LIMIT_Q30, H_LIMIT_Q30),
            ]
    return []
