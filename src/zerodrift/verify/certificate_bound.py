"""What the certificate says of the error bound: the float model, how far the chip is from it."""

from zerodrift.export.error_bound import ErrorBound, round_up
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.errors import CAUSES
from zerodrift.operations.signals import Real, Signal
from zerodrift.verify.certificate_conversions import describe_conversions

Line = dict[str, object]


def describe_bound(bound: ErrorBound, model: IntegerModel) -> dict[str, object]:
    """Return the keys `error_bound` and, where something is proven, `float_model`.

    The float model is a list of signals, each after those that it is made of. A signal is what
    `operation` makes of the signals `of`, which are their places in the list, with `numbers` as
    they were before rounding; the chip has it as `node`[`index`] scale + offset. null among the
    numbers is no limit.
    """
    if not bound.outputs:
        about = "Nothing is proven of the distance from the float model."
        return {"error_bound": {"about": about, "why": bound.why}}
    lines: list[Line] = []
    places: dict[int, int] = {}
    for answer in bound.answers:
        _list_signals(answer, lines, places)
    claims = [
        {
            "output": output.name,
            "unit": output.unit,
            "counts_per_unit": output.lsb_per_unit,
            "signal": places[id(_meaning(answer))],
            "bound": round_up(error.total),
            "causes": {name: round_up(getattr(error, name)) for name in CAUSES},
        }
        for output, answer, error in zip(model.outputs, bound.answers, bound.outputs, strict=True)
    ]
    conversions = describe_conversions(model)
    told = {"conversions": conversions} if conversions else {}
    return {"holds": bound.holds, "error_bound": claims, "float_model": lines, **told}


def _meaning(signal: Signal) -> Real:
    assert signal.meaning is not None
    return signal.meaning


def _list_signals(signal: Signal, lines: list[Line], places: dict[int, int]) -> int:
    """Add a signal and all that it is made of; return its place."""
    real = _meaning(signal)
    if id(real) not in places:
        of = [_list_signals(x, lines, places) for x in real.inputs]
        places[id(real)] = len(lines)
        lines.append(
            {
                "node": signal.node,
                "index": signal.index,
                "scale": signal.scale,
                "offset": signal.offset,
                "operation": real.operation,
                "of": of,
                "numbers": [None if abs(x) == float("inf") else x for x in real.numbers],
            }
        )
    return places[id(real)]
