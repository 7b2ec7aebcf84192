"""Additions to the integer ONNX for a variable step: the time of a step, and the rate flag."""

from collections.abc import Mapping

from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.arithmetic import INT32_MAX
from zerodrift.operations.onnx_writer import OnnxWriter
from zerodrift.operations.times import LONGEST_US, MOST_HELD_US

SLEPT = "slept"
"""Name of the state that is added to the next step's time."""


def split_time(w: OnnxWriter, model: IntegerModel, given: str) -> tuple[str, str]:
    """Write codes [B, C] and, of a variable step, its time [B] of what a step is given."""
    if not model.variable_step:
        return given, ""
    channels = len(model.channels)
    codes = w.split(given, (channels, 1))[0]
    time = w.column(given, channels)
    longest = w.constant(LONGEST_US)
    negative = w.op("Less", time, w.constant(0))
    return codes, w.op("Where", negative, longest, w.minimum(time, longest))


def write_span(w: OnnxWriter, state: Mapping[str, str], time: str) -> str:
    """Write the time [B] since the last step, 0 before the first; "" without a variable step."""
    if not time:
        return ""
    slept = w.op("Squeeze", state[SLEPT], w.constant([1]))
    span = w.minimum(w.add(time, slept), w.constant(LONGEST_US))
    return w.op("Where", w.op("Equal", state["steps"], w.constant(0)), w.constant(0), span)


def write_rate(w: OnnxWriter, model: IntegerModel, moved: str, span: str) -> str:
    """Write whether the temperature [B] moved by more than the model allows."""
    most = w.constant(model.guards.rate_max)
    if not span:
        return w.op("Greater", moved, most)
    held = w.saturate(span, model.period_us, MOST_HELD_US)
    change = w.mul(w.minimum(moved, w.constant(INT32_MAX)), w.constant(model.period_us))
    fast = w.op("Greater", change, w.mul(most, held))
    return w.op("And", fast, w.op("LessOrEqual", span, w.constant(MOST_HELD_US)))
