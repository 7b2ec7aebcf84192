"""What the check of host against reference rests on, and that it finds every planted fault."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.reference import Reference
from zerodrift.verify.host_check import check_host, check_starts, choose_chunk

FULL = Shape(front_end=("delay", "lowpass", "product"), inputs=3, hidden=6, outputs=2)
WINDOWED = Shape(window=4, hidden=5, outputs=2, inputs=2)


@pytest.mark.parametrize("shape", [FULL, WINDOWED], ids=["stream", "window"])
def test_packed_state_holds_everything(shape: Shape) -> None:
    """The induction of check_host needs unpack(pack(s)) to go on exactly as s does."""
    codes = Draw(1).codes(-32768, 32767, 3, 60, shape.inputs)
    reference = Reference(draw_model(shape, 5))
    whole = reference.run(codes)
    first = reference.run(codes[:, :25])
    packed = first.state.pack()
    layout = reference.start(codes[:1, 0].astype(np.int64), settled=True)
    second = reference.run(codes[:, 25:], state=layout.unpack(packed))
    np.testing.assert_array_equal(second.drift, whole.drift[:, 25:])
    np.testing.assert_array_equal(second.flags, whole.flags[:, 25:])
    np.testing.assert_array_equal(second.state.pack(), whole.state.pack())


@pytest.mark.parametrize("shape", [FULL, WINDOWED], ids=["stream", "window"])
@pytest.mark.parametrize("weights", ["int16", "int8"])
def test_sequences_of_a_batch_do_not_touch_each_other(shape: Shape, weights: str) -> None:
    """And it needs a chunk in a batch of 256 to be what it would be on its own."""
    shape = replace(shape, weights=weights)
    codes = Draw(2).codes(-32768, 32767, 256, 12, shape.inputs)
    reference = Reference(draw_model(shape, 6))
    together = reference.run(codes)
    for i in (0, 7, 255):
        alone = reference.run(codes[i : i + 1])
        np.testing.assert_array_equal(alone.drift[0], together.drift[i])
        np.testing.assert_array_equal(alone.state.pack()[0], together.state.pack()[i])


@pytest.mark.parametrize("chunk", [1, 7, 16, 1000])
def test_check_gives_the_same_answer_for_every_chunk_length(chunk: int, tmp_path: Path) -> None:
    model = draw_model(FULL, 7)
    host = HostModel(model, generate(model), tmp_path, flags=("-O1",))
    codes = Draw(3).codes(-32768, 32767, 100, FULL.inputs)
    for settled in (True, False):
        check = check_host(host, codes, settled=settled, chunk=chunk)
        assert check.mismatch is None
        assert check.steps == 100


FAULTS = {
    "floor instead of rounding": (r"zd_round_shift64\(\(int64_t\)", "zd_asr64((int64_t)"),
    "low-pass off by one": (r"(zd_lowpass\(&s->\w+), in_1", r"\1, 1 + in_1"),
    "delay one step long": (r"= s->(\w+)_line\[s->\w+\];", r"= s->\1_line[0];"),
    "state zeroed on every call": (r"(    uint32_t flags = 0;\n)", r"\1    s->gru_h_q30[0] = 0;\n"),
    "relaxed once, not 64 times": (r"ZD_GRU_RELAX_STEPS", "1u"),
    "rate flag off by one": (r"\+ 1000\) > 2000u\)", "+ 1001) > 2002u)"),
    "clamp flag forgotten": (r"if \(limited != wide\)", "if (0)"),
    "steps counted twice": (r"s->steps\+\+;", "s->steps += 2u;"),
    "head reads the state before the step": (
        r"(    gru_step\(.*, -1\);\n)(    zd_gru_copy_state\(.*;\n)",
        r"\2\1",
    ),
}
"""What is wrong -> (pattern in the generated source, what it becomes)."""


@pytest.mark.spread(4, "fault", FAULTS)
def test_check_finds_a_planted_fault(fault: str, tmp_path: Path) -> None:
    shape = replace(FULL, code_limit=20000, drift_limit=60.0)
    model = draw_model(shape, 12)
    code = generate(model)
    pattern, becomes = FAULTS[fault]
    source, count = re.subn(pattern, becomes, code.source)
    assert count > 0, "the fault has no place in the source any more: plant it anew"
    bad = GeneratedCode(code.prefix, code.header, source, code.harness)
    host = HostModel(model, bad, tmp_path, flags=("-O1",))
    walk = Draw(4).uniform(-1010.0, 1010.0, 400, 3).cumsum(axis=0)
    codes = np.clip(walk + 5000, -32000, 30000).astype(np.int16)
    codes[200, 0] = codes[199, 0] + 1001  # one more than the rate that the guard admits
    checks = [check_host(host, codes, settled=settled) for settled in (True, False)]
    found = [check.mismatch for check in checks if check.mismatch is not None]
    assert found, f"not found: {fault}"
    assert "expected" in str(found[0]) and "0x" in str(found[0])


def test_first_differing_step_is_named(tmp_path: Path) -> None:
    model = draw_model(WINDOWED, 8)
    code = generate(model)
    late = code.source.replace(
        "    uint32_t flags = 0;\n",
        "    uint32_t flags = 0;\n    static uint32_t zd_calls;\n    zd_calls++;\n",
        1,
    ).replace(
        "    return flags;\n}",
        "    drift[1] ^= (zd_calls == 38u) ? 1 : 0;\n    return flags;\n}",
        1,
    )
    bad = GeneratedCode(code.prefix, code.header, late, code.harness)
    host = HostModel(model, bad, tmp_path, flags=("-O1",), observe=False)
    mismatch = check_host(host, Draw(5).codes(-3000, 3000, 100, 2)).mismatch
    assert mismatch is not None
    assert (mismatch.step, mismatch.where) == (37, "drift[1]")
    assert "N against" in mismatch.physical


@pytest.mark.parametrize("settled", [True, False])
def test_starts_of_many_sequences_are_checked_together(settled: bool, tmp_path: Path) -> None:
    model = draw_model(FULL, 9)
    code = generate(model)
    sequences = {
        name: Draw(6 + i).codes(-3000, 3000, 5 + 20 * i, FULL.inputs)
        for i, name in enumerate(("short", "long"))
    }
    host = HostModel(model, code, tmp_path / "good", flags=("-O1",))
    outcome = check_starts(host, sequences, 8, settled=settled)
    assert outcome.mismatch is None
    assert outcome.steps == 2 * 5
    pattern, becomes = FAULTS["delay one step long"]
    source, count = re.subn(pattern, becomes, code.source)
    assert count > 0
    bad = GeneratedCode(code.prefix, code.header, source, code.harness)
    host = HostModel(model, bad, tmp_path / "bad", flags=("-O1",))
    found = check_starts(host, sequences, 8, settled=settled).mismatch
    assert found is not None
    assert "in the start of 'short'" in str(found)


@pytest.mark.parametrize("total", [1, 15, 16, 255, 4096, 15803, 15900, 10**6])
def test_chunks_are_few_and_the_last_one_short(total: int) -> None:
    chunk = choose_chunk(total)
    least = max(16, min(512, -(-total // 256)))
    assert least <= chunk <= 1.25 * least
    assert chunk + total % chunk <= least + total % least
