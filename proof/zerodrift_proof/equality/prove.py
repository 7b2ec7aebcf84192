"""C equals specification, for every input: both are run over terms, and must be the same terms.

Every other way to compile a model: what may differ from the plain C, and what tables hold.

What is shown of a firmware folder's C, for a model's file: the state that `init` and `settle`
leave, what `step` gives and leaves of any state and input, that `state_is_sound` lets through what
the specification says and nothing else, what `save` and `restore` do, the names in the header, and
the self-test's answer. Sums are exact integers: every operation of the C is shown to fit its type
on the way. Kernels in plain C are shown apart (`build`), those in assembly from their object code
(`zerodrift_proof.object`), where somebody builds it. Those of intrinsics are taken at the
specification, once their tables are shown to be the model's, and told as such.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift_proof.equality.build import (
    OPEN,
    PROVEN,
    TESTED,
    UNCHECKED,
    Proof,
    ShownPart,
    shape,
    shape_variable,
    tell,
)
from zerodrift_proof.equality.kernels import Layers, Numbered
from zerodrift_proof.equality.machine import (
    CellBlock,
    Found,
    Instance,
    Number,
    Rule,
    Spot,
    TermMachine,
)
from zerodrift_proof.equality.model import (
    Model,
)
from zerodrift_proof.equality.parser import parse_all
from zerodrift_proof.equality.reader import choose_lines, list_asked, preprocess, read_numbers
from zerodrift_proof.equality.rules import Used, make_assembly, make_rules
from zerodrift_proof.equality.specification import Specification
from zerodrift_proof.equality.syntax import PFunction, PProgram
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

INTRINSICS = ("zd_gru_pairs_t", "zd_gru_rows_t", "zd_gru_columns_t", "zd_lstm_rows_t")
"""Constants of kernels that have intrinsics, where they are not in assembly."""
KERNELS = ("PORTABLE", "PAIRS", "ROWS", "COLUMNS")
PAIRS = 1
CHOICES: dict[str, tuple[int | None, ...]] = {
    "ZD_KERNEL": (0, 1, 2, 3),
    "ZD_GRU_ASSEMBLY": (None, 6, 7),
    "ZD_SMALL": (None, 1),
    "ZD_UNALIGNED": (None, 1),
}
"""What a build may define that a model's files ask for, and as what; None: not at all."""
DERIVED = "ZD_ASSEMBLY"
"""What the runtime makes of the first two: assembly of layers without a kernel in C for pairs."""
FIXED = ("ZD_RUNTIME_FORMAT", "ZD_RUNTIME_ID", *(f"ZD_KERNEL_{name}" for name in KERNELS))


@dataclass(frozen=True)
class PWay:
    """One way through the conditions of a model's files."""

    defined: Mapping[str, int]

    @property
    def name(self) -> str:
        """What a build of this kind defines."""
        words = []
        for macro, value in self.defined.items():
            if macro == "ZD_KERNEL":
                words.append(f"ZD_KERNEL_{KERNELS[value]}")
            else:
                words.append(macro if value == 1 else f"{macro} {value}")
        return ", ".join(words)

    @property
    def is_plain(self) -> bool:
        """Whether every layer is a kernel in plain C."""
        is_portable = self.defined.get("ZD_KERNEL", 0) == 0
        return is_portable and "ZD_GRU_ASSEMBLY" not in self.defined

    @property
    def macros(self) -> dict[str, str]:
        """All that a model's files can ask for, ZD_ASSEMBLY too."""
        assembly = self.defined.get("ZD_GRU_ASSEMBLY", 0)
        derived = assembly if self.defined.get("ZD_KERNEL", 0) == PAIRS else 0
        given = {"ZD_KERNEL": 0, **self.defined, DERIVED: derived}
        return {name: str(value) for name, value in given.items()}


def list_ways(texts: Mapping[str, str], prefix: str) -> Iterator[tuple[PWay, PProgram]]:
    """Yield every different text that the choices of a build make of a model's files.

    Raises:
        RefusedError: something without a rule.
    """
    asked = list_asked(texts[f"{prefix}.c"], f"{prefix}.c")
    if DERIVED in asked:
        asked |= {"ZD_KERNEL", "ZD_GRU_ASSEMBLY"}
    free = [name for name in CHOICES if name in asked]
    fixed = read_numbers(texts, FIXED)
    seen = set()
    for values in itertools.product(*(CHOICES[name] for name in free)):
        given = {n: v for n, v in zip(free, values, strict=True) if v is not None}
        way = PWay(given)
        lines = choose_lines(texts, prefix, {**fixed, **way.macros})
        if lines not in seen:
            seen.add(lines)
            tokens = preprocess(texts, prefix, {**fixed, **way.macros}, with_runtime=False)
            yield way, parse_all(tokens, prefix)


def show_kernels(
    model: Model, texts: Mapping[str, str], prefix: str, proven: ProvenKernels, small: bool
) -> Iterator[ShownPart]:
    """Yield what is shown of each other way to compile the model.

    Nothing but the layers' tables and the calls of their kernels may differ from the plain C, and
    each kernel's table must hold the model's weights in its order. Intrinsics themselves are tested
    (docs/reference/kernels.md), not proven; assembly is where `proven` holds its object code.

    Args:
        model: as its file has it.
        texts: file name -> content.
        prefix: of the model.
        proven: what is proven of object code.
        small: whether plain C with ZD_SMALL is proven by itself.
    """
    if not list_asked(texts[f"{prefix}.c"], f"{prefix}.c") & {*CHOICES, DERIVED}:
        return
    ways = list(list_ways(texts, prefix))
    plain = ways[0][1]
    for way, program in ways[1:]:
        if way.is_plain and small and "ZD_UNALIGNED" not in way.defined:
            continue
        try:
            why = _hold_way(model, program, plain, prefix)
        except UNCHECKED as error:
            why = tell(error)
        verdict = PROVEN if way.is_plain or _is_covered(way, program, proven) else TESTED
        yield ShownPart("kernels of recurrent layers", way.name, OPEN if why else verdict, why)


def _is_covered(way: PWay, program: PProgram, proven: ProvenKernels) -> bool:
    """Return whether every kernel of a way is plain C, or assembly that is proven."""
    ends = {name.removesuffix("_assembly") for name in program.assembly}
    intrinsics = {v.name for v in program.constants if v.type.name in INTRINSICS} - ends
    return bool(ends) and not intrinsics and proven.hold(way.defined, ends)


def _hold_way(model: Model, program: PProgram, plain: PProgram, prefix: str) -> str:
    used = Used()
    holder: list[Specification] = []
    rules: dict[str, Rule] = make_rules(prefix, lambda: holder[0].layers, used)
    own = program.constants
    machine_program = replace(program, claims=[], constants=[])
    machine = TermMachine(machine_program, rules)
    meaning = Specification(machine.terms, model)
    holder.append(meaning)
    names = {*meaning.layers.layers}
    apart = {f"{name}_{end}" for name in names for end in ("step", "is_sound", "assembly")}
    tables = {v.name for v in own} - {v.name for v in plain.constants}
    tables |= {
        f"{name}_{end}" for name in names for end in ("w_x", "w_h", "bias", "multiplier", "stream")
    }
    if why := _find_difference(program, plain, apart, names | tables):
        return why
    if unknown := {*program.assembly} - {f"{name}_assembly" for name in names}:
        return f"{min(unknown)} is the assembly of no layer"
    for variable in own:
        machine._declare(variable, machine.globals)
    for name in sorted(names):
        layer = meaning.layers.layers[name]
        constants = machine.globals[name]
        assert isinstance(constants, Instance)
        if f"{name}_assembly" in program.assembly:
            rules[f"{name}_assembly"] = make_assembly(lambda: meaning.layers, layer, constants)
        for relaxing in (False, True):
            if why := _hold_step(machine, meaning.layers, layer, relaxing):
                return why
        sound = machine.call(f"{name}_is_sound", [])
        if not isinstance(sound, Number) or sound.term.exact != 1:
            return f"{name}_is_sound does not know its own tables"
    return ""


def _hold_step(machine: TermMachine, layers: Layers, layer: Numbered, relaxing: bool) -> str:
    """Return why a layer's own function is no step of it, its kernel taken as specified."""
    from zerodrift_proof.equality.kernels import CELL_LIMIT, H_LIMIT_Q30

    terms, hidden = machine.terms, layer.hidden
    x = [terms.symbol(f"x{i}", -32768, 32767) for i in range(layer.inputs)]
    h = [terms.symbol(f"h{j}", -H_LIMIT_Q30, H_LIMIT_Q30) for j in range(hidden)]
    c = [terms.symbol(f"c{j}", -CELL_LIMIT, CELL_LIMIT) for j in range(hidden)]
    c = c if layer.kind == "lstm" else []
    blocks = [CellBlock("x", "int16_t", (layer.inputs,), list(x))]
    blocks.append(CellBlock("h", "int32_t", (hidden,), list(h)))
    if c:
        blocks.append(CellBlock("c", "int32_t", (hidden,), list(c)))
    given: list[Found] = [Spot(b, terms.constant(0), b.sizes) for b in blocks]
    mode = machine.constant(int(relaxing), "uint32_t") if c else machine.constant(int(relaxing) - 1)
    machine.call(f"{layer.name}_step", [*given, mode])
    wanted = layers.step(layer.name, x, h, c, relaxing)
    for block, numbers in zip(blocks[1:], wanted, strict=False):
        if any(cell is not term for cell, term in zip(block.cells, numbers, strict=True)):
            return f"{layer.name}_step is no step of the layer"
    return ""


def _find_difference(program: PProgram, plain: PProgram, apart: set[str], tables: set[str]) -> str:
    """Return what differs from the plain C beside the layers' functions and tables."""
    for one, other in ((program, plain), (plain, program)):
        for name, function in one.functions.items():
            if name in apart:
                continue
            twin = other.functions.get(name)
            if twin is None or _shape_function(twin) != _shape_function(function):
                return f"{name} is another than in plain C"
        for variable in one.constants:
            if variable.name in tables:
                continue
            twins = [v for v in other.constants if v.name == variable.name]
            if len(twins) != 1 or shape_variable(twins[0]) != shape_variable(variable):
                return f"{variable.name} is another than in plain C"
        if one.structs.keys() != other.structs.keys():
            return "other structs than in plain C"
        for name, fields in one.structs.items():
            own = [shape_variable(v) for v in fields]
            if own != [shape_variable(v) for v in other.structs[name]]:
                return f"{name} is another than in plain C"
    return ""


def _shape_function(function: PFunction) -> tuple[object, ...]:
    parameters = tuple(shape_variable(v) for v in function.parameters)
    return function.result, parameters, shape(function.body)


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
    prefix = model.c_prefix
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
        for build, shown in show_builds(texts, model.c_prefix, layers, objects, progress):
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
