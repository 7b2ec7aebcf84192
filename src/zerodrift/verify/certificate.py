"""The overflow certificate: every bound that the arithmetic of a model relies on, and of what C.

What is claimed here holds for any codes that the types of the inputs can hold. It is written by the
prover that the quantizer uses; zerodrift-proof derives it again from the C alone.
"""

import hashlib
import json
from collections.abc import Mapping

from zerodrift import __version__
from zerodrift.blocks.design import BlockDesign
from zerodrift.blocks.proof import BlockField
from zerodrift.c_runtime.compilers import list_runtime
from zerodrift.codegen.generate import GeneratedCode
from zerodrift.export.error_bound import ErrorBound
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.gru.cell import H_LIMIT_Q30
from zerodrift.operations.intervals import Bound
from zerodrift.operations.tables import STEP_BITS, T_MAX, T_MIN, tanh_nodes
from zerodrift.verify.certificate_bound import describe_bound

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
