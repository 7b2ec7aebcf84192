"""C equals specification, for every input: both are run over terms, and must be the same terms.

What is shown of a firmware folder's C, for a model's file: the state that `init` and `settle`
leave, what `step` gives and leaves of any state and input, that `state_is_sound` lets through what
the specification says and nothing else, what `save` and `restore` do, the names in the header, and
the self-test's answer. Sums are exact integers: every operation of the C is shown to fit its type
on the way. Kernels in plain C are shown apart (`prove_lemmas`), those in assembly from their object
code (`object_proof`), where a compiler for their cores is at hand. Those of intrinsics are taken at
the specification, once their tables are shown to be the model's, and told as such.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from zerodrift.base.errors import CheckError, InputError
from zerodrift.codegen.names import name_prefix
from zerodrift.export.integer_model import IntegerModel
from zerodrift.verify.checkers import is_known
from zerodrift.verify.object_proof import (
    ProvenKernels,
    ShownKernel,
    check_program,
    find_assembly,
    show_builds,
    show_program,
)
from zerodrift.verify.prove_build import Proof
from zerodrift.verify.prove_kernels import Layers
from zerodrift.verify.prove_parts import OPEN, PROVEN, TESTED, UNCHECKED, ShownPart, tell
from zerodrift.verify.prove_ways import show_kernels

PLAIN = {"ZD_KERNEL": "0"}
BUILDS: tuple[tuple[str, Mapping[str, str]], ...] = (
    ("plain C", {**PLAIN, "ZD_LANES": "1u"}),
    ("plain C, two at a time", {**PLAIN, "ZD_LANES": "2u"}),
    ("plain C, small", {**PLAIN, "ZD_LANES": "1u", "ZD_SMALL": ""}),
)
"""What is defined when the C is read; the second and third where there is a network."""


def prove(
    model: IntegerModel, texts: Mapping[str, str], progress: Callable[[str], None] = lambda _: None
) -> tuple[ShownPart, ...]:
    """Return what is shown of a model's C.

    Args:
        model: as its file has it.
        texts: file name -> content, of the model's header and source and of the runtime.
        progress: is told what is being done.
    """
    return tuple(list_shown(model, texts, progress))


def list_shown(
    model: IntegerModel,
    texts: Mapping[str, str],
    progress: Callable[[str], None] = lambda _: None,
    *,
    objects: bool = False,
    program: Path | None = None,
) -> Iterator[ShownPart]:
    """Yield what `prove` returns, part by part.

    Args:
        model: as its file has it.
        texts: file name -> content, of the model's header and source and of the runtime.
        progress: is told what is being done.
        objects: build the C for cores that have assembly, and prove that from its object code.
        program: a user's own program, whose kernels in assembly are proven too.

    Raises:
        InputError: `program` cannot be read, or holds no kernel of the model.
    """
    prefix = name_prefix(model)
    if program is not None:
        check_program(program, texts[f"{prefix}.c"])
    yield _show_runtime(texts)
    builds = BUILDS if model.recurrents or _has_network(texts, prefix) else BUILDS[:1]
    try:
        first: Proof | None = None
        for name, defined in builds:
            progress(f"proving {name}")
            proof = Proof(model, texts, prefix, name, defined)
            same = first is not None and proof.is_own_text(first)
            yield from proof.run(whole=not same)
            first = first or proof
        proven = ProvenKernels()
        if model.recurrents and first is not None:
            layers = first.meaning.layers
            if objects:
                yield from show_objects(model, texts, layers, proven, progress)
            if program is not None:
                progress(f"proving {program}")
                names = find_assembly(texts, prefix, layers)
                yield from map(_judge_kernel, show_program(program, layers, names))
        if first is not None:
            progress("other ways to compile it")
            yield from show_kernels(model, texts, prefix, proven, len(builds) > 1)
    except UNCHECKED as error:
        yield ShownPart("the C", "", OPEN, tell(error))


def show_objects(
    model: IntegerModel,
    texts: Mapping[str, str],
    layers: Layers,
    proven: ProvenKernels,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[ShownPart]:
    """Yield what is shown of the assembly's object code; `proven` is told of what holds."""
    try:
        prefix, outputs = name_prefix(model), len(model.outputs)
        for build, shown in show_builds(texts, prefix, outputs, layers, progress):
            proven.add(build, shown)
            yield from map(_judge_kernel, shown)
    except InputError as error:
        yield ShownPart("kernels in assembly", "object code", TESTED, str(error))
    except CheckError as error:
        yield ShownPart("kernels in assembly", "object code", OPEN, str(error))


def _judge_kernel(kernel: ShownKernel) -> ShownPart:
    return ShownPart(kernel.what, kernel.build, OPEN if kernel.why else PROVEN, kernel.why)


def is_proven(shown: Sequence[ShownPart]) -> bool:
    """Return whether nothing is left open."""
    return bool(shown) and all(one.verdict != OPEN for one in shown)


def _has_network(texts: Mapping[str, str], prefix: str) -> bool:
    return '"zd_network.h"' in texts[f"{prefix}.c"]


def _show_runtime(texts: Mapping[str, str]) -> ShownPart:
    """CRC, save, restore and what other compilers see of the runtime: its text is known."""
    if is_known(texts):
        return ShownPart("runtime, by its hash", "", TESTED)
    return ShownPart(
        "runtime, by its hash", "", OPEN, "no text that was compared with the reference"
    )
