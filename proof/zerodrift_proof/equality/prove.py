"""C equals specification, for every input: both are run over terms, and must be the same terms.

What is shown of a firmware folder's C, for a model's file: the state that `init` and `settle`
leave, what `step` gives and leaves of any state and input, that `state_is_sound` lets through what
the specification says and nothing else, what `save` and `restore` do, the names in the header, and
the self-test's answer. Sums are exact integers: every operation of the C is shown to fit its type
on the way. Kernels in plain C are shown apart (`lemmas`), those in assembly from their object
code (`zerodrift_proof.object`), where somebody builds it. Those of intrinsics are taken at the
specification, once their tables are shown to be the model's, and told as such.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from zerodrift_proof.equality.build import Proof
from zerodrift_proof.equality.kernels import Layers
from zerodrift_proof.equality.model import Model
from zerodrift_proof.equality.parts import OPEN, PROVEN, TESTED, UNCHECKED, ShownPart, tell
from zerodrift_proof.equality.ways import show_kernels
from zerodrift_proof.known_runtime import is_known
from zerodrift_proof.object.image import ProgramError
from zerodrift_proof.object.program import (
    Builder,
    BuildError,
    NoCompilerError,
    ProvenKernels,
    ShownKernel,
    check_program,
    find_assembly,
    show_builds,
    show_program,
)

PLAIN = {"ZD_KERNEL": "0"}
BUILDS: tuple[tuple[str, Mapping[str, str]], ...] = (
    ("plain C", {**PLAIN, "ZD_LANES": "1u"}),
    ("plain C, two at a time", {**PLAIN, "ZD_LANES": "2u"}),
    ("plain C, small", {**PLAIN, "ZD_LANES": "1u", "ZD_SMALL": ""}),
)
"""What is defined when the C is read; the second and third where there is a network."""


def list_shown(
    model: Model,
    texts: Mapping[str, str],
    progress: Callable[[str], None] = lambda _: None,
    *,
    objects: Builder | None = None,
    program: Path | None = None,
) -> Iterator[ShownPart]:
    """Yield what is shown of a model's C, part by part.

    Args:
        model: as its file has it.
        texts: file name -> content, of the model's header and source and of the runtime.
        progress: is told what is being done.
        objects: builds the C for cores that have assembly, which is proven from that object code.
        program: a user's own program, whose kernels in assembly are proven too.

    Raises:
        ProgramError: `program` cannot be read, or holds no kernel of the model.
    """
    prefix = model.prefix
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
            if objects is not None:
                yield from show_objects(model, texts, layers, proven, objects, progress)
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
    model: Model,
    texts: Mapping[str, str],
    layers: Layers,
    proven: ProvenKernels,
    objects: Builder,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[ShownPart]:
    """Yield what is shown of the assembly's object code; `proven` is told of what holds."""
    try:
        for build, shown in show_builds(texts, model.prefix, layers, objects, progress):
            proven.add(build, shown)
            yield from map(_judge_kernel, shown)
    except NoCompilerError as error:
        yield ShownPart("kernels in assembly", "object code", TESTED, str(error))
    except (BuildError, ProgramError) as error:
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
