"""The lines by which a program uses the generated C, to be copied into it."""

from collections.abc import Sequence
from pathlib import PurePosixPath

from zerodrift.codegen.identifiers import sanitize_outputs

SNIPPET = """\
#include "{prefix}.h"

static {prefix}_state_t state;              /* one per sensor */
static {prefix}_input_t in;                 /* raw codes, as the hardware gives them */
static int32_t drift[{PREFIX}_OUTPUTS];

void start(void) {{                         /* at power-on, with the first reading in `in` */
    if ({prefix}_selftest() != 0) {{
        for (;;) {{ /* the chip does not compute what was verified */ }}
    }}
    {prefix}_settle(&state, &in);
}}

uint32_t every_sample(int32_t counts[{PREFIX}_OUTPUTS]) {{
    uint32_t flags = {prefix}_step(&state, &in, drift);
{lines}
    return flags;                           /* 0: all is well; else {PREFIX}_FLAG_... */
}}
"""


def write_snippet(files: Sequence[str], outputs: Sequence[str]) -> str:
    """Return the lines for a firmware; they compile beside its header as they are.

    Args:
        files: what was written; the header with a source of the same name is the model's.
        outputs: names of the outputs, in order.
    """
    stems = {PurePosixPath(name).stem for name in files if name.endswith(".c")}
    heads = [PurePosixPath(name).stem for name in files if name.endswith(".h")]
    prefix = next((name for name in heads if name in stems), heads[0] if heads else "model")
    upper = prefix.upper()
    lines = "\n".join(
        f"    counts[{upper}_{name}] -= drift[{upper}_{name}]; "
        f"/* {upper}_{name}_LSB_PER_UNIT counts make one unit */"
        for name in (one.upper() for one in sanitize_outputs(outputs, prefix))
    )
    return SNIPPET.format(prefix=prefix, PREFIX=upper, lines=lines)
