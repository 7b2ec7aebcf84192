"""Faults planted in kernels' machine code and tables: how many are proven although they differ.

    python -m benchmarks bench_object_proof [--quick]
    python -m benchmarks.bench_object_proof --faults 1000 --seed 5

Golden models are built for the cores that have assembly. Bits of instructions, operands, whole
instructions, weights and lines of tanh are changed in the program's bytes, and the kernel is proven
again as `verify --prove` does it. Whatever is proven all the same runs on the emulated core beside
the program as it was, with features and states drawn at random: memory and registers must be the
same after the call. Of the others every tenth runs too, so that the share of faults among them is
known. Exit code 1: a program as it was is not proven, or a fault is.
"""

import argparse
import random
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.golden.vectors import load

from benchmarks.bench_copies import bound as bound_rate
from benchmarks.object_oracle import KernelChip, draw_given
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.codegen.generate import generate
from zerodrift.tasks.verify import build_program
from zerodrift_proof import read_model
from zerodrift_proof.equality.kernels import Numbered
from zerodrift_proof.equality.specification import Specification
from zerodrift_proof.equality.terms import Terms
from zerodrift_proof.object.image import Image, Kernel, read_image
from zerodrift_proof.object.program import BUILDS, prove_kernel

SUBJECTS = (
    ("ordinary", 0), ("reset_before", 0), ("int8", 0), ("lstm", 0), ("ordinary", 2),
    ("reset_before", 2), ("int8", 2), ("lstm", 2), ("odd_hidden", 1), ("one_input", 3),
    ("ordinary", 4), ("reset_before", 4), ("odd_hidden", 5), ("reset_before", 5),
)  # fmt: skip
"""Golden model, and which of `BUILDS`."""
KINDS = ("bit", "bit", "bit", "two bits", "operand", "swap", "repeat", "weight", "line of tanh")
ASKED, TRIED = 10, 300
"""Of so many faults that are not proven one runs; with so many drawn features and states."""


@dataclass(frozen=True)
class Subject:
    """A kernel in a program."""

    name: str
    core: str
    image: Image
    kernel: Kernel
    layer: Numbered

    def prove(self, image: Image) -> str:
        """Return why its kernel is no step in time, or none towards rest."""
        ranges = [(-32768, 32767)] * self.layer.inputs
        for relaxing in (False, True):
            if why := prove_kernel(image, self.kernel, self.layer, ranges, relaxing):
                return why
        return ""

    def find_difference(self, image: Image, chip: KernelChip, rng: random.Random) -> bool:
        """Return whether another program gives something else for something drawn."""
        for _ in range(TRIED):
            given = draw_given(self.layer, rng)
            chip.write(self.image)
            wanted = chip.run(given, self.layer)
            assert wanted is not None
            chip.write(image)
            if chip.run(given, self.layer) != wanted:
                return True
        return False


def make_subject(name: str, number: int, folder: Path) -> Subject:
    """Build a golden model for a core."""
    model, build = load(name).model, BUILDS[number]
    code = generate(model)
    texts = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    texts |= {code.header_name: code.header, code.source_name: code.source}
    folder.mkdir()
    image = read_image(build_program(texts, code.prefix, len(model.outputs), build, folder))
    layer = next(iter(Specification(Terms(), read_model(model.to_json())).layers.layers.values()))
    (kernel,) = image.find_kernels(layer.name)
    form = ", small table" if build.small else ""
    return Subject(f"{name}, {build.core}{form}", build.core, image, kernel, layer)


def plant(subject: Subject, kind: str, rng: random.Random) -> Image:
    """Return a subject's program with a fault."""
    image, kernel = subject.image, subject.kernel
    if kind in ("weight", "line of tanh"):
        places = [(kernel.stream, kernel.stream_bytes)]
        if kind == "line of tanh":
            places = [(s.value, s.size) for s in image.symbols if s.name.startswith("zd_tanh_")]
        at, size = rng.choice(places)
        return _flip(image, at + rng.randrange(size), 1 << rng.randrange(8))
    code = image.read(kernel.at, kernel.size)
    assert code is not None
    at, size = rng.choice(_list_instructions(code))
    if kind == "bit":
        return _flip(image, kernel.at + at + rng.randrange(size), 1 << rng.randrange(8))
    if kind == "two bits":
        where = kernel.at + at + rng.randrange(size)
        return _flip(image, where, rng.choice([a | b for a in _ONE for b in _ONE if a != b]))
    if kind == "operand":
        return _flip(
            image, kernel.at + at + rng.randrange(size), rng.randint(1, 15) << rng.choice((0, 4))
        )
    others = [(a, s) for a, s in _list_instructions(code) if s == size and a != at]
    other, _ = rng.choice(others)
    if kind == "swap":
        nearby = [(a, s) for a, s in others if abs(a - at) == size]
        other, _ = rng.choice(nearby or others)
    first, second = code[at : at + size], code[other : other + size]
    changed = image.change(kernel.at + at, second)
    return changed.change(kernel.at + other, first) if kind == "swap" else changed


_ONE = tuple(1 << k for k in range(8))


def _flip(image: Image, at: int, mask: int) -> Image:
    old = image.read(at, 1)
    assert old is not None
    return image.change(at, bytes([old[0] ^ mask]))


def _list_instructions(code: bytes) -> list[tuple[int, int]]:
    """Return where instructions lie, and their bytes; words of data behind them look like some."""
    found, at = [], 0
    while at < len(code) - 1:
        size = 4 if code[at + 1] >> 3 >= 29 and at + 4 <= len(code) else 2
        found.append((at, size))
        at += size
    return found


def main(quick: bool) -> None:
    """Plant 30 faults, or 1,000."""
    if not run(30 if quick else 1000, seed=5):
        raise SystemExit(1)


def run(count: int, seed: int, first: int = 0) -> bool:
    """Plant faults and prove what comes of them; print what was missed."""
    told: Counter[str] = Counter()
    kinds: Counter[str] = Counter()
    missed, good, seconds = 0, True, 0.0
    with tempfile.TemporaryDirectory() as scratch:
        used = SUBJECTS[: min(count, len(SUBJECTS))]
        subjects = [
            make_subject(name, number, Path(scratch) / f"{k}")
            for k, (name, number) in enumerate(used)
        ]
    for subject in subjects:
        began = time.process_time()
        why = subject.prove(subject.image)
        seconds = max(seconds, time.process_time() - began)
        if why:
            good = False
            print(f"NOT PROVEN {subject.name}: {why}")
    chips = [KernelChip(s.core, s.image, s.kernel) for s in subjects]
    for number in range(first, first + count):
        rng = random.Random(f"{seed} {number}")
        subject, chip = subjects[number % len(subjects)], chips[number % len(subjects)]
        kind = rng.choice(KINDS)
        image = plant(subject, kind, rng)
        if image.spans == subject.image.spans:
            told["no change"] += 1
            continue
        kinds[kind] += 1
        why = subject.prove(image)
        told["not proven" if why else "proven"] += 1
        if why and number // len(subjects) % ASKED:
            continue
        differs = subject.find_difference(image, chip, rng)
        told[
            f"{'not proven' if why else 'proven'}, {'another' if differs else 'the same'} result"
        ] += 1
        if differs and not why:
            missed += 1
            print(f"MISSED {subject.name} {number}: {kind}")
    drawn = sum(kinds.values())
    sorts = ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
    print(f"kernels as they are: {len(subjects)}, both kinds of step; CPU at most {seconds:.1f} s")
    print(f"faults planted: {drawn} ({sorts}; seed {seed})")
    for what, n in sorted(told.items()):
        print(f"  {what}: {n}")
    print(f"proven although the result differs: {missed} of {drawn};"
          f" at most {100 * bound_rate(missed, drawn):.2f} %")  # fmt: skip
    return good and not missed


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.bench_object_proof", description=__doc__
    )
    parser.add_argument("--faults", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    given = parser.parse_args()
    raise SystemExit(0 if run(given.faults, given.seed, given.first) else 1)
