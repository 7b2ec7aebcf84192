"""Writes the runtime's one generated file, src/zd_runtime.c, with the reference's tables."""

from zerodrift.c_runtime.compilers import RUNTIME_DIRECTORY
from zerodrift.codegen.generate import make_environment
from zerodrift.operations.exp2 import OCTAVE_Q29
from zerodrift.operations.tables import tanh_nodes

RUNTIME_SOURCE = RUNTIME_DIRECTORY / "src" / "zd_runtime.c"


def render_runtime_source() -> str:
    """Return zd_runtime.c with the tables that the reference uses."""
    template = make_environment().get_template("zd_runtime.c.j2")
    return template.render(nodes=tanh_nodes().tolist(), octave=OCTAVE_Q29)


if __name__ == "__main__":
    temporary = RUNTIME_SOURCE.with_suffix(".part")
    temporary.write_text(render_runtime_source(), encoding="utf-8")
    temporary.replace(RUNTIME_SOURCE)
