"""The certificate and the proof of a variable step's C, and of C that was changed."""

import hashlib
import json

import pytest

from tests.prove.models import prove
from tests.variable_step.models import make_model
from zerodrift.c_runtime.host import render_sources
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.verify.certificate import certify
from zerodrift_proof.certificate.check import CertificateOutcome, compare
from zerodrift_proof.equality.build import OPEN, PROVEN, TESTED

MODEL = make_model()
CODE = generate(MODEL)
LOWPASSES = [n for n in MODEL.nodes if isinstance(n, IntegerLowpassAfter)]
WAITING = next(b for b in MODEL.prove() if b.where.endswith(".waiting")).interval.high


def check(model: IntegerModel, code: GeneratedCode, source: str) -> CertificateOutcome:
    """Hold the certificate of a model's C against another source that claims to be it."""
    texts = {**render_sources(code), code.source_name: source}
    digests = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}
    return compare({**json.loads(certify(model, code)), "files": digests}, texts)


@pytest.mark.parametrize("guarded", [False, True])
def test_certificate_holds(guarded: bool) -> None:
    model = make_model(guarded=guarded)
    code = generate(model)
    outcome = check(model, code, code.source)
    assert outcome.understood
    assert not outcome.failures
    assert outcome.holds > 40


RATE, SHIFT = LOWPASSES[0].rate_q31, LOWPASSES[0].shift
CHANGES = {
    "collected time beyond its test": (f"_waiting > {WAITING}", f"_waiting > {WAITING - 1}"),
    "test of a collected time too wide": (f"_waiting > {WAITING}", f"_waiting > {WAITING + 1}"),
    "time slept may be negative": ("(s->slept_us < 0) || ", ""),
    "time slept not limited": (f"(s->slept_us > INT64_C({2**61}))", "(s->slept_us > INT64_MAX)"),
    "low-pass without a rate": (f"span_us, {RATE}", "span_us, 0"),
    "low-pass too slow for 32 bits": (f"{RATE}, {SHIFT}u)", f"{1 << 10}, 50u)"),
    "negative time": ("span_us = zd_add_span(s->slept_us, elapsed_us)", "span_us = -1"),
    "time slept of a new state": ("(s->steps != 0u)", "(s->steps == 0u)"),
    "state not asked": ("if (asleep_state_is_sound(s) == 0u)", "if (s->steps > 9u)"),
}


@pytest.mark.spread(3, "name", sorted(CHANGES))
def test_changed_c_is_refuted(name: str) -> None:
    before, after = CHANGES[name]
    assert before in CODE.source
    assert check(MODEL, CODE, CODE.source.replace(before, after, 1)).failures


def test_proof_takes_the_runtime_at_its_tests_and_shows_the_rest() -> None:
    shown = prove(MODEL, render_sources(CODE))
    verdicts = {one.what: one.verdict for one in shown}
    assert OPEN not in verdicts.values()
    assert verdicts["functions of a variable step"] == TESTED
    for what in ("step", "step_after", "restore", "restore_after", "settle", "selftest"):
        assert verdicts[what] == PROVEN


WRONG = {
    "step_after": ("s->slept_us = 0;", ""),
    "step": ("in, UINT64_C(", "in, UINT64_C(1"),
    "restore_after": ("zd_add_span(s->slept_us, age_us)", "zd_add_span(0, age_us)"),
    "state_is_sound": ("_waiting < 0)", "_waiting < 1)"),
}


@pytest.mark.spread(2, "what", sorted(WRONG))
def test_changed_c_is_not_proven(what: str) -> None:
    before, after = WRONG[what]
    assert before in CODE.source
    texts = render_sources(CODE)
    texts[CODE.source_name] = CODE.source.replace(before, after, 1)
    found = {one.what for one in prove(MODEL, texts) if one.verdict == OPEN}
    assert what in found


def test_low_passes_of_another_node_are_not_proven() -> None:
    """Two low-passes whose arguments are exchanged."""
    one, two = (f"{n.rate_q31}, {n.shift}u" for n in LOWPASSES[:2])
    source = CODE.source.replace(one, "@").replace(two, one).replace("@", two)
    texts = {**render_sources(CODE), CODE.source_name: source}
    found = {one.what for one in prove(MODEL, texts) if one.verdict == OPEN}
    assert f"node {LOWPASSES[0].name}" in found
