"""That the C is the specification, as zerodrift-proof shows it; builds the object code it asks
for."""

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from zerodrift.base.errors import CheckError, InputError
from zerodrift.c_runtime.cores import MEMORY, find_cross_compilers
from zerodrift.codegen.identifiers import name_prefix
from zerodrift.export.integer_model import IntegerModel
from zerodrift.verify.checkers import (
    BuildError,
    NoCompilerError,
    ObjectBuild,
    ProgramError,
    ShownPart,
    list_shown,
    read_model,
)

PROGRAM = """\
#include "{prefix}.c"
#include "zd_runtime.c"
{memory}{prefix}_state_t state;
{prefix}_input_t input;
int32_t drift[{count}];
void _start(void);
void _start(void) {{
    {prefix}_settle(&state, &input);
    (void){prefix}_step(&state, &input, drift);
}}
"""


def prove_model(
    model: IntegerModel,
    texts: Mapping[str, str],
    progress: Callable[[str], None] = lambda _: None,
    program: Path | None = None,
) -> tuple[ShownPart, ...]:
    """Return what is shown of a model's C, and of the object code of its kernels in assembly.

    Args:
        model: as its file has it.
        texts: file name -> content, of the model's header and source and of the runtime.
        progress: is told what is being done.
        program: a user's own program, whose kernels in assembly are proven too.

    Raises:
        InputError: `program` cannot be read, or holds no kernel of the model.
    """
    prefix, outputs = name_prefix(model), len(model.outputs)

    def build(one: ObjectBuild) -> bytes:
        with tempfile.TemporaryDirectory() as scratch:
            try:
                return build_program(texts, prefix, outputs, one, Path(scratch)).read_bytes()
            except InputError as error:
                raise NoCompilerError(str(error)) from error
            except CheckError as error:
                raise BuildError(str(error)) from error

    read = read_model(model.to_json())
    try:
        return tuple(list_shown(read, texts, progress, objects=build, program=program))
    except ProgramError as error:
        raise InputError(str(error)) from error


def build_program(
    texts: Mapping[str, str], prefix: str, outputs: int, build: ObjectBuild, folder: Path
) -> Path:
    """Compile and link a model's C for a core.

    Args:
        texts: file name -> content, of the model's header and source and of the runtime.
        prefix: of the model's names.
        outputs: how many it has.
        build: what to build it for.
        folder: to build it in.

    Raises:
        InputError: there is no compiler.
        CheckError: the C does not compile.
    """
    compilers = find_cross_compilers(build.core)
    if not compilers:
        raise InputError(f"no compiler for {build.core}: `pip install ziglang`")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    main, program = folder / "zd_proof.c", folder / "proof.elf"
    main.write_text(PROGRAM.format(memory=MEMORY, prefix=prefix, count=outputs), encoding="utf-8")
    free = ["-std=c99", "-O2", *build.flags, "-ffreestanding", f"-I{folder}", str(main)]
    if compilers[0].name == "gcc":
        free += ["-nostdlib", "-Wl,-Ttext=0x10000,-Tdata=0x100000,--no-relax", "-lgcc"]
    compilers[0].run([*free, "-o", str(program)])
    return program
