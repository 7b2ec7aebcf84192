"""How a program uses the generated C: lines to copy, an application, its CAN frames (DBC)."""

from collections.abc import Sequence
from pathlib import PurePosixPath

from zerodrift import __version__
from zerodrift.codegen.generate import make_environment
from zerodrift.codegen.identifiers import (
    name_channels,
    name_outputs,
    name_prefix,
    sanitize_comment,
    sanitize_outputs,
)
from zerodrift.dataset.chip_codes import MEASURED, TEMPERATURE_LSB_DEGC
from zerodrift.export.integer_model import IntegerModel

# The lines by which a program uses the generated C, to be copied into it.

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


# The CAN frames of a model as a DBC file, and an application that sends them, as text.

FIRST_FRAME_ID = 0x100
"""Two identifiers per output from here on, of the 11-bit range."""


def render_dbc(model: IntegerModel) -> str:
    """Return a DBC file with two frames per output.

    `<NAME>_MEASURED` holds what was measured and the drift, `<NAME>_COMPENSATED` their difference,
    the flags of the step and a counter of the steps. Values are int32 counts, little-endian, with
    the scale that makes them the output's unit.
    """
    lines = [f'VERSION "{model.hash[:16]}"', "", "NS_ :", "", "BS_:", "", "BU_: SENSOR", ""]
    for k, name in enumerate(name_outputs(model)):
        output = model.outputs[k]
        unit = sanitize_comment(output.unit)
        scale = repr(1.0 / output.lsb_per_unit)
        low, high = -(2**31) / output.lsb_per_unit, (2**31 - 1) / output.lsb_per_unit
        value = f'({scale},0) [{low!r}|{high!r}] "{unit}" Vector__XXX'
        first = FIRST_FRAME_ID + 2 * k
        lines += [
            f"BO_ {first} {name.upper()}_MEASURED: 8 SENSOR",
            f" SG_ Raw : 0|32@1- {value}",
            f" SG_ Drift : 32|32@1- {value}",
            "",
            f"BO_ {first + 1} {name.upper()}_COMPENSATED: 7 SENSOR",
            f" SG_ Compensated : 0|32@1- {value}",
            ' SG_ Flags : 32|8@1+ (1,0) [0|255] "" Vector__XXX',
            ' SG_ Counter : 40|16@1+ (1,0) [0|65535] "" Vector__XXX',
            "",
        ]
    return "\n".join(lines)


def render_application(model: IntegerModel) -> str:
    """Return the C of an application: thermometer, other inputs, step, CAN frames.

    A thermometer whose codes are not a TMP117's is read as the board's other channels are.
    """
    prefix = name_prefix(model)
    names = name_outputs(model)
    thermometer = model.channels[model.guards.temperature_channel]
    of_outputs = {f"{MEASURED}{output.name}": k for k, output in enumerate(model.outputs)}
    return (
        make_environment()
        .get_template("application.c.j2")
        .render(
            model=model,
            version=__version__,
            title=sanitize_comment(model.name),
            prefix=prefix,
            PREFIX=prefix.upper(),
            channels=name_channels(model),
            outputs=[name.upper() for name in names],
            can_names=names,
            measured={
                k: of_outputs[channel.source]
                for k, channel in enumerate(model.channels)
                if channel.source in of_outputs
            },
            guards=model.guards,
            is_tmp117=thermometer.bits == 16
            and thermometer.lsb == TEMPERATURE_LSB_DEGC
            and thermometer.conversion is None,
        )
    )
