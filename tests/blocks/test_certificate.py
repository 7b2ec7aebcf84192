"""The certificate of a design: for every block that the chip accepts, derived again from the C."""

import hashlib
import json
import re
from dataclasses import replace

import pytest

from tests.blocks.test_blocks import find_code, find_design, list_units
from zerodrift.base.errors import CheckError
from zerodrift.blocks.design import make_design
from zerodrift.blocks.proof import prove_set
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.generate import generate_design
from zerodrift.verify.certificate import certify_design
from zerodrift_proof.certificate.check import CertificateOutcome, compare


def derive_again(change=lambda text: text, network: bool = True) -> CertificateOutcome:
    """Return what becomes of the claims about a C that was changed, its hash told anew."""
    design, code = find_design(network), find_code(network)
    told = json.loads(certify_design(design, code))
    texts = {code.header_name: code.header, code.source_name: change(code.source)}
    texts |= {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    told["files"] = {
        name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()
    }
    return compare(told, texts)


@pytest.mark.spread(1, "network", [False, True])
def test_it_holds(network: bool) -> None:
    outcome = derive_again(network=network)
    assert outcome.understood and not outcome.failures
    assert outcome.holds > len(find_design(network).fields)


def test_it_holds_of_a_guarded_state() -> None:
    units = [replace(unit, guarded=True) for unit in list_units(network=True)[:3]]
    design = make_design(units)
    code = generate_design(design)
    texts = {code.header_name: code.header, code.source_name: code.source}
    texts |= {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    outcome = compare(json.loads(certify_design(design, code)), texts)
    assert outcome.understood and not outcome.failures


def swap(pattern: str, to: str):
    """Return a change of the C: the first match of a pattern, which must be there."""

    def change(text: str) -> str:
        changed = re.sub(pattern, to, text, count=1)
        assert changed != text
        return changed

    return change


@pytest.mark.spread(
    3,
    "change",
    [
        swap(r"(within_i32\(b->drift_coefficients, \d+u, )-\d+", r"\g<1>-5"),
        swap(r"(within_i32\(&b->in_0_high, 1u, -?\d+, )\d+", r"\g<1>2147483647"),
        swap(r"(within_u8\(b->\w+_shift, \d+u, 0u, )\d+u", r"\g<1>64u"),
        swap(r"(rows_within\(b->\w+, \d+u, \d+u, )\d+u", r"\g<1>65536u"),
        swap(r"    within &= cell_rows_within.*\n", ""),
        swap(r"    within &= cell_within_i64.*\n", ""),
        swap(r"(within_i32\(b->drift_coefficients, )\d+u", r"\g<1>2u"),
        swap(r"\(x\[k\] > high\)", "(x[k] > high + 1)"),
        swap(r"norm \+= ", "norm = "),
        swap(r"\(b == NULL\) \|\| ", ""),
        swap(r"if \(b == NULL\) \{\n        return;[^\n]*\n    \}\n", ""),
        swap(r"cell_is_admissible\(b\) != 0u\) \? 0u : ", "cell_is_admissible(b) != 2u) ? 0u : "),
        swap(r"bytes < sizeof\(cell_block_t\)", "bytes < 8u"),
        swap(
            r"!= b->crc\) \{\n        return CELL_BLOCK_DAMAGED", "!= b->crc) {\n        return 0u"
        ),
        swap(r"\? second : first", "? first : second"),
        swap(r"\(int32_t\)zd_round_shift64\((.*), \d+u\)", r"(int32_t)zd_round_shift64(\1, 12u)"),
    ],
)
def test_a_c_that_lets_more_through_is_refused(change) -> None:
    outcome = derive_again(change)
    assert outcome.failures


def test_a_set_that_is_too_wide_is_not_proven() -> None:
    design = find_design(network=True)
    for name, low, high in (
        ("drift_bias", -(2**63), 2**63 - 1),
        ("drift_head_coefficients", -(2**33), 2**33),
        ("in_0_low", 0, 32767),
        ("dense_0_bias", -(2**31), 2**31 - 1),
        ("dense_0_shift", 0, 32),
    ):
        fields = [
            replace(f, low=low, high=high) if f.place.name == name else f for f in design.fields
        ]
        assert fields != list(design.fields), name
        with pytest.raises(CheckError):
            prove_set(design.model, fields)
