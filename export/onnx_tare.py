"""What the integer ONNX has more where the drift can be counted from a moment on."""

from zerodrift.export.integer_model import FLAG_CLAMPED, FLAG_TARED
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN
from zerodrift.operations.onnx_writer import OnnxWriter

TARE = "tare"
"""Name of the state: the last answers, what is taken off, and whether it is."""


def write_count_from(
    w: OnnxWriter, tare: str, drift: str, flags: str, clamped: str, outputs: int
) -> tuple[str, str, str]:
    """Write the state after a step, drift [B, K] from the tare on, and flags [B].

    Args:
        w: the writer.
        tare: [B, 2 K + 1] the state before it.
        drift: [B, K] as the model gives it.
        flags: [B] without those of the tare.
        clamped: [B] 1 where the flag of a limited drift is among them.
        outputs: K.
    """
    with w.label(TARE):
        _, off, kept = w.split(tare, (outputs, outputs, 1))
        tared = w.op("Equal", kept, w.constant(2))  # [B, 1]
        wide = w.sub(drift, off)
        counted = w.op("Where", tared, w.saturate(wide, INT32_MIN, INT32_MAX), drift)
        differs = w.flag(w.op("And", tared, w.op("Not", w.op("Equal", counted, wide))))
        limited = w.op("ReduceMax", differs, axes=[1], keepdims=0)
        more = w.mul(w.mul(limited, w.sub(w.constant(1), clamped)), w.constant(FLAG_CLAMPED))
        told = w.op("Squeeze", w.flag(tared, FLAG_TARED), w.constant([1]))
        state = w.op("Where", tared, w.constant(2), w.constant(1))
        after = w.op("Concat", drift, off, state, axis=1)
        return after, counted, w.add(w.add(flags, more), told)
