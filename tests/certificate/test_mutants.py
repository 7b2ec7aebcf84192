"""Generated C with one thing changed: what the checker lets pass cannot overflow.

A mutant that the checker accepts is compiled with traps for everything that C leaves undefined and
run on rails, noise, jumps and walks over all that the inputs' types hold; it tests itself, is saved
and restored. It must not trap. Some of those that are refused are seen to trap; others would need
inputs that no sequence here has.
"""

import faulthandler
import hashlib
import json
import multiprocessing
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.certificate.test_check import list_texts
from tests.golden.model_factory import Shape, draw_model
from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import Compiler, find_compilers
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import IntegerModel
from zerodrift.verify.certificate import certify
from zerodrift.verify.vectors import draw_sequences
from zerodrift_proof.certificate.check import judge_each

pytestmark = pytest.mark.long

SHAPE = Shape(
    inputs=3,
    hidden=4,
    outputs=2,
    front_end=("lowpass", "product", "delay", "difference", "root", "exp2", "play", "load"),
    measured=(0,),
    dense=((3, "relu6"),),
    code_limit=12000,
)
TRAPS = (
    "-O0",
    "-fsanitize=signed-integer-overflow,shift,bounds,integer-divide-by-zero",
    "-fsanitize-undefined-trap-on-error",
)
EXTREMES = {"int8_t": 127, "int16_t": 32767, "int32_t": 2**31 - 1, "int64_t": 2**63 - 1}
CLAMP = re.compile(r"zd_clamp(?:32|64)\(((?:[^()]|\((?:[^()]|\([^()]*\))*\))*?), [^,]+?, [^,()]+\)")
TABLE = re.compile(r"static const (int\d+_t) \w+\[[^=]*= \{([^;]*)\};")


@dataclass(frozen=True)
class Mutant:
    """A source with one thing changed."""

    what: str
    source: str


def draw_mutant(source: str, rng: np.random.Generator) -> Mutant:
    """Change a number, a table's entry, a saturation or a widening cast.

    Not what the harness observes with, which is nothing on the chip.
    """
    kind = str(rng.choice(["number", "entry", "saturation", "cast"], p=[0.5, 0.2, 0.2, 0.1]))
    first = source.index("_rest(")  # the functions; claims and tables are before
    if kind == "entry":
        table = _choose(rng, list(TABLE.finditer(source, 0, source.index("ZD_CLAIM("))))
        number = _choose(rng, list(re.finditer(r"-?\d+", table[2])))
        low, high = table.start(2) + number.start(), table.start(2) + number.end()
        extreme = EXTREMES[table[1]]
        value = rng.choice([str(extreme), str(-extreme), str(2 * int(number[0]) + 1)])
        if table[1] == "int64_t":
            value = f"{value[:1]}{int(value[1:] or 0)}"
        return _replace(source, low, high, str(value), kind)
    if kind == "saturation":
        found = _choose(rng, list(CLAMP.finditer(source, first)))
        return _replace(source, found.start(), found.end(), f"({found[1]})", kind)
    if kind == "cast":
        found = _choose(rng, list(re.finditer(r"\(int64_t\)", source[first:])))
        return _replace(source, first + found.start(), first + found.end(), "", kind)
    code = re.sub(r"ZD_OBSERVE\(.*", lambda m: " " * len(m[0]), source[first:])
    found = _choose(rng, list(re.finditer(r"(?<![\w.])\d+(?=u?\b)", code)))
    old = int(found[0])
    new = int(rng.choice([old + 1, max(old - 1, 0), 2 * old + 1, 16 * min(old, 2**50), 0]))
    return _replace(source, first + found.start(), first + found.end(), str(new), kind)


def _choose(rng: np.random.Generator, found: list[re.Match[str]]) -> re.Match[str]:
    return found[rng.integers(len(found))]


def _replace(source: str, start: int, end: int, text: str, kind: str) -> Mutant:
    line = source.rfind("\n", 0, start) + 1
    context = source[line : source.index("\n", end)].strip()
    return Mutant(
        f"{kind} {source[start:end]:.60} -> {text:.60} in {context:.120}",
        source[:start] + text + source[end:],
    )


def is_refused(code: GeneratedCode, certificate: str, mutant: Mutant) -> bool:
    """Ask the checker about C by someone who also corrected the hash."""
    claims = json.loads(certificate)
    claims["files"][code.source_name] = hashlib.sha256(mutant.source.encode()).hexdigest()
    texts = {**list_texts(code), code.source_name: mutant.source}
    return any(outcome.failures for outcome in judge_each(claims, texts))


def run_trapped(model: IntegerModel, code: GeneratedCode, folder: Path) -> None:
    """Run C with traps on every sequence; exit 9 if it does not compile."""
    faulthandler.disable()  # a trap is what is looked for
    compiler = find_compilers()[0]
    quiet = Compiler(compiler.name, (*compiler.command, "-w"))
    try:
        host = HostModel(model, code, folder, quiet, flags=(*TRAPS, "-Wno-error"))
    except CheckError:
        raise SystemExit(9) from None
    host.selftest()
    for settled, codes in enumerate(draw_sequences(model, 1500).values()):
        host.run(codes, settled=settled % 2 == 0)
        host.run(codes[::-1], settled=settled % 2 == 1)
        saved = host.save()
        host.restore(saved)
        host.restore(bytes([saved[0] ^ 1]) + saved[1:])
        host.run(codes[:9], restart=False)


def judge_mutants(count: int, seed: int, folder: Path) -> tuple[Counter[str], list[str]]:
    """Return how many mutants were what, and every accepted one that trapped."""
    model = draw_model(SHAPE, 3)
    code = generate(model)
    certificate = certify(model, code)
    rng, told, missed = np.random.default_rng(seed), Counter[str](), []
    for number in range(count):
        mutant = draw_mutant(code.source, rng)
        if mutant.source == code.source:
            told["unchanged"] += 1
            continue
        refused = is_refused(code, certificate, mutant)
        changed = GeneratedCode(code.prefix, code.header, mutant.source, code.harness)
        process = multiprocessing.get_context("fork").Process(
            target=run_trapped, args=(model, changed, folder / str(number))
        )
        process.start()
        process.join()
        ended = {0: "runs", 9: "does not compile"}.get(process.exitcode or 0, "traps")
        told[f"{'refused' if refused else 'accepted'}, {ended}"] += 1
        if not refused and ended == "traps":
            missed.append(mutant.what)
    return told, missed


def test_mutant_that_is_accepted_never_traps(tmp_path: Path) -> None:
    told, missed = judge_mutants(5, 1, tmp_path)
    assert missed == []
    assert told["refused, traps"] > 0, told


@pytest.mark.slow
def test_many_mutants_that_are_accepted_never_trap(tmp_path: Path) -> None:
    _, missed = judge_mutants(300, 2, tmp_path)
    assert missed == []
