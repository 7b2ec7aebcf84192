"""The overflow certificate: every bound that the arithmetic of a model relies on, and of what C.

What is claimed here holds for any codes that the types of the inputs can hold. It is written by the
prover that the quantizer uses; zerodrift-proof derives it again from the C alone.
"""

import hashlib
import json
from collections.abc import Mapping

from zerodrift import __version__
from zerodrift.base.column_config import ConversionConfig
from zerodrift.blocks.design import BlockDesign
from zerodrift.blocks.proof import BlockField
from zerodrift.c_runtime.compilers import list_runtime
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.codegen.identifiers import name_channels
from zerodrift.dataset.chip_codes import find_linear
from zerodrift.dataset.conversions import COUPLES, PLATINUM
from zerodrift.export.error_bound import ErrorBound, round_up
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.errors import CAUSES
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.intervals import Bound
from zerodrift.operations.recurrent import H_LIMIT_Q30
from zerodrift.operations.signals import Real, Signal
from zerodrift.operations.tables import STEP_BITS, T_MAX, T_MIN, tanh_nodes

# What the certificate says of conversions: the formulas that the chip's tables stand for.

Row = dict[str, object]
PLATINUM_SPAN_DEGC = (-200.0, 850.0)
"""Over which IEC 60751 states its equations."""


def describe_conversions(model: IntegerModel) -> list[Row]:
    """Return a row for each input whose raw codes a table converts.

    `kind` is of value `scale` + `offset`, through the `divider` where there is one: "line" is that
    itself; "beta" and "steinhart" a thermistor in ohm; "table" and "polynomial"; "inverse" the
    temperature whose function, in `pieces` of polynomials (with a0 exp(a1 (t - a2)^2) beside some),
    has the value. With a `junction` the value is a sum of raw code and junction's voltage.
    """
    names = name_channels(model)
    rows = []
    for name, channel in zip(names, model.channels, strict=True):
        by = channel.conversion
        if by is None or by.is_plain:
            continue
        row: Row = {"input": name, "unit": channel.unit, **_describe(by.by_sum)}
        if by.junction is not None:
            of = model.channels[by.junction.channel]
            junction = {"input": names[by.junction.channel], "scale": of.lsb, "offset": of.offset}
            row |= {"raw_scale": by.formula.scale, "raw_offset": by.formula.offset}
            row |= {"junction": junction}
        rows.append(row)
    return rows


def _describe(by: ConversionConfig) -> Row:
    row: Row = {"kind": by.kind, "scale": by.scale, "offset": by.offset}
    if by.divider is not None:
        side = "low" if by.divider.is_low else "high"
        ends = {"series_ohm": by.divider.series_ohm, "counts": by.divider.counts}
        row |= {"divider": {**ends, "side": side}}
    if by.kind == "ntc" and by.steinhart:
        return row | {"kind": "steinhart", "coefficients": list(by.steinhart)}
    if by.kind == "ntc":
        return row | {"kind": "beta", "r25_ohm": by.r25_ohm, "beta_K": by.beta_K}
    if by.kind in ("pt100", "pt1000"):
        r0 = 100.0 if by.kind == "pt100" else 1000.0
        return row | {"kind": "inverse", "pieces": _describe_platinum(r0)}
    if by.kind == "thermocouple":
        couple = by.couple or ""
        row |= {"kind": "inverse", "pieces": _describe_couple(couple)}
        return row if not by.junction_degC else row | {"junction_degC": by.junction_degC}
    if by.kind == "table":
        return row | {"points": [list(point) for point in by.points]}
    if by.kind == "polynomial":
        return row | {"coefficients": list(by.coefficients)}
    linear = find_linear(by)
    assert linear is not None
    return {"kind": "line", "scale": linear[0], "offset": linear[1]}


def _describe_platinum(r0_ohm: float) -> list[Row]:
    """Return the resistance over the temperature (IEC 60751:2022, equations 1 and 2), in ohm."""
    a, b, c = PLATINUM
    warm = [r0_ohm, r0_ohm * a, r0_ohm * b]
    cold = [*warm, -100.0 * r0_ohm * c, r0_ohm * c]
    low, high = PLATINUM_SPAN_DEGC
    return [
        {"low": low, "high": 0.0, "coefficients": cold},
        {"low": 0.0, "high": high, "coefficients": warm},
    ]


def _describe_couple(couple: str) -> list[Row]:
    """Return the voltage over the temperature, in V."""
    rows = []
    for piece in COUPLES[couple]:
        row: Row = {"low": piece.low_degC, "high": piece.high_degC}
        row |= {"coefficients": [c * 1e-3 for c in piece.coefficients]}
        if piece.bump:
            row |= {"bump": [piece.bump[0] * 1e-3, *piece.bump[1:]]}
        rows.append(row)
    return rows


# What the certificate says of the error bound: the float model, how far the chip is from it.

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


# The overflow certificate: every bound that the arithmetic of a model relies on, and of what C.

FORMAT = 1
FILE_NAME = "certificate.json"


def certify(model: IntegerModel, code: GeneratedCode, bound: ErrorBound | None = None) -> str:
    """Return the text of certificate.json, always the same for the same model and C.

    Args:
        model: the integer model.
        code: the C that was generated of it.
        bound: what is proven of its distance from the float model; None: nothing is said of that.

    Raises:
        CheckError: a bound of the model does not hold.
    """
    return _write(model, model.hash, model.prove(), code, bound, frozenset(), {})


def certify_design(design: BlockDesign, code: GeneratedCode) -> str:
    """Return the text of certificate.json of a design: its claims hold for every block of the set.

    Args:
        design: of the program.
        code: the C that was generated of it.

    Raises:
        CheckError: a bound does not hold for some block.
    """
    held = frozenset((f.place.node, f.place.attribute) for f in design.fields)
    fields: list[dict[str, object]] = [
        {
            "where": f"b->{field.place.name}",
            "low": field.low,
            "high": field.high,
            **({"row": field.row, "norm": field.norm} if field.norm else {}),
            **_describe_layer(field),
        }
        for field in design.fields
    ]
    return _write(
        design.model, design.identity, design.prove(), code, None, held, {"blocks": fields}
    )


def _describe_layer(field: BlockField) -> dict[str, object]:
    """Return the sizes of a GRU no sum of which leaves 32 bits."""
    if not field.pairs:
        return {}
    names = ("units", "x_pairs", "h_pairs")
    return dict(zip(names, (field.place.sizes[0], *field.pairs), strict=True))


def _write(
    model: IntegerModel,
    identity: str,
    bounds: list[Bound],
    code: GeneratedCode,
    bound: ErrorBound | None,
    held: frozenset[tuple[str, str]],
    further: Mapping[str, object],
) -> str:
    """Return the text.

    Args:
        model: what the C was generated of.
        identity: what the C calls itself.
        bounds: what is proven.
        code: the C.
        bound: of the distance from the float model.
        held: nodes and their attributes that lie in a block.
        further: claims beside those.
    """
    texts = {code.header_name: code.header, code.source_name: code.source}
    texts |= list_runtime(code.header, code.source)
    grus = [layer for layer in model.recurrents if isinstance(layer, IntegerGruLayer)]
    own = [node for node in model.nodes if (node.name, "newer_q31") not in held]
    idle = frozenset[str]().union(*(node.idle for node in own))
    body: dict[str, object] = {
        "certificate": FORMAT,
        "about": "Nothing overflows, for any input code. Derived from the weights by intervals;"
        " `zerodrift verify --certificate` derives it again from the C alone.",
        "generator": f"zerodrift {__version__}",
        "model": identity,
        "prefix": code.prefix,
        "files": {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()},
        "inputs": [
            {
                "channel": channel.name,
                "low": channel.raw_least,
                "high": channel.raw_most,
            }
            for channel in model.channels
        ],
        **({"checksum": "check"} if model.guarded else {}),
        "invariants": [
            _describe_invariant(name) for layer in grus for name in layer.name_layers(".")
        ],
        "tables": [_describe_table()] if model.recurrents else [],
        "shifts": [
            {"where": shift.where, "shift": int(shift.amount), "most": shift.most}
            for node in (*model.conversions, *model.nodes)
            if (node.name, "shift") not in held
            for shift in node.list_shifts()
        ],
        "bounds": [
            {
                "where": line.where,
                "low": int(line.interval.low),
                "high": int(line.interval.high),
                "bits": line.bits,
            }
            for line in bounds
            if line.where not in idle
        ],
        **further,
        **({} if bound is None else describe_bound(bound, model)),
    }
    return format_certificate(body)


def format_certificate(body: dict[str, object]) -> str:
    """Return a certificate's JSON text, one claim to a line."""
    lines = []
    for key, value in body.items():
        if isinstance(value, list) and value:
            rows = ",\n".join("  " + json.dumps(row, ensure_ascii=False) for row in value)
            lines.append(f" {json.dumps(key)}: [\n{rows}\n ]")
        else:
            lines.append(f" {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _describe_invariant(name: str) -> dict[str, object]:
    return {
        "where": f"{name}.h_q30",
        "low": -H_LIMIT_Q30,
        "high": H_LIMIT_Q30,
        "because": [
            "h starts at 0, or where a step or the relaxation to rest left it",
            "|n| <= 2^30 - 2^15 and u <= 1 - 2^-16, from the table",
            "h' = h + 2 round(d u / 2^32) with d = n - h moves by d u within 1",
            "|d| >= 2^16: it moves by |d| - 2^-16 |d| + 1 <= |d| at most and does not pass n",
            "|d| < 2^16: it passes n by 1 at most, hence |h'| <= |n| + 1",
        ],
    }


def _describe_table() -> dict[str, object]:
    """Return what any int32 reads of the table of tanh: a line of it, and a result in Q0.30."""
    lines = ((T_MAX - T_MIN) >> STEP_BITS) + 1
    largest = int(tanh_nodes().max()) << STEP_BITS
    return {"where": "tanh", "lines": lines, "low": -largest, "high": largest}
