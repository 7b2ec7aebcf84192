"""Kinds of foreign networks: taken to the bit, or refused by name; one table."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.onnx.kinds import GRU_KINDS, LSTM_KINDS, LSTM_REFUSED, Kind
from tests.onnx.layer_norms import NORM_KINDS, NORM_REFUSED
from tests.onnx.min_grus import MIN_GRU_KINDS
from tests.onnx.test_kinds import make_integer_model, read

from zerodrift.base.errors import InputError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.host_check import check_host
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.vectors import draw_sequences

GROUPS: dict[str, Mapping[str, Kind]] = {
    "GRU": GRU_KINDS,
    "minGRU": MIN_GRU_KINDS,
    "LSTM": LSTM_KINDS | LSTM_REFUSED,
    "LayerNorm": NORM_KINDS | NORM_REFUSED,
}


@dataclass
class Count:
    """What became of the kinds of one group."""

    taken: int = 0
    exact: int = 0
    """Of those taken: reference, C of this host and integer ONNX agree in every bit."""
    refused: int = 0
    """By the words that name what is in the way."""


def main(quick: bool) -> None:
    """Print the table, and every kind with which something else happened than was to."""
    steps = 40 if quick else 400
    print(f"foreign networks, as PyTorch exports them and by hand; {steps} steps of each sequence")
    print("  group      kinds  taken  0 LSB  refused by name  otherwise")
    others: list[str] = []
    for name, kinds in GROUPS.items():
        count = Count()
        wrong = [f"{name}: {k}: {told}" for k in kinds if (told := _try(kinds[k], count, steps))]
        others += wrong
        print(
            f"  {name:10} {len(kinds):5} {count.taken:6} {count.exact:6} {count.refused:16}"
            f" {len(wrong):10}"
        )
    for line in others:
        print(f"  {line}")


def _try(kind: Kind, count: Count, steps: int) -> str:
    """Count what becomes of a kind; return what is wrong with that, or nothing."""
    try:
        _, imported = read(kind)
    except InputError as error:
        if kind.refused and kind.refused in str(error):
            count.refused += 1
            return ""
        return f"refused: {error}"
    count.taken += 1
    if kind.refused:
        return "taken, and was to be refused"
    model = make_integer_model(imported)
    code = generate(model)
    with tempfile.TemporaryDirectory() as scratch:
        host, onnx = HostModel(model, code, Path(scratch), flags=("-O1",)), OnnxModel(model)
        for sequence, codes in draw_sequences(model, steps).items():
            for check in (
                check_host(host, codes, settled=True),
                check_onnx(onnx, host, codes, settled=True),
            ):
                if check.mismatch is not None:
                    return f"{sequence}: {check.mismatch}"
    count.exact += 1
    return ""
