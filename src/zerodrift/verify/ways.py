"""The ways in which one C is compiled: every layout and kernel in it, on host and cores."""

import importlib.util
import platform
from dataclasses import dataclass

from zerodrift.c_runtime.compilers import HOST_MVE_DIRECTORY
from zerodrift.c_runtime.cores import list_emulated
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.gru.layouts import has_fast_kernels
from zerodrift.operations.tables import TANH

HOST = "host"


@dataclass(frozen=True)
class Way:
    """One way to compile the C, which gives the same bits as every other."""

    name: str
    """As it is told: cortex-m4, or `host: pairs`."""
    core: str
    """host, or one of `cores.list_emulated`."""
    flags: tuple[str, ...] = ()
    needs: str = ""
    """What the host must be or have: x86-64, avx2."""


def _kernel(name: str) -> str:
    return f"-DZD_KERNEL=ZD_KERNEL_{name}"


_ROWS = Way("host: rows, MVE lane by lane", HOST, (_kernel("ROWS"), f"-I{HOST_MVE_DIRECTORY}"))
_HOST_FAST = (
    Way("host: columns with SSE2", HOST, (_kernel("COLUMNS"),), "x86-64"),
    Way("host: columns with AVX2", HOST, (_kernel("COLUMNS"), "-mavx2"), "avx2"),
    Way("host: pairs", HOST, (_kernel("PAIRS"),)),
    Way("host: pairs, ZD_SMALL", HOST, (_kernel("PAIRS"), "-DZD_SMALL")),
    _ROWS,
)
_HOST_ANY = (
    Way("host: portable", HOST, (_kernel("PORTABLE"), "-DZD_LANES=1u")),
    Way("host: portable, two lanes", HOST, (_kernel("PORTABLE"), "-DZD_LANES=2u")),
    Way("host: portable, ZD_SMALL", HOST, (_kernel("PORTABLE"), "-DZD_SMALL")),
)
_CORES_FAST = (
    Way("cortex-m4: ZD_SMALL", "cortex-m4", ("-DZD_SMALL",)),
    Way("cortex-m4: aligned", "cortex-m4", ("-mno-unaligned-access",)),
    Way("cortex-m4: intrinsics", "cortex-m4", ("-DZD_NO_ASSEMBLY",)),
    Way("cortex-m4: portable", "cortex-m4", (_kernel("PORTABLE"),)),
    Way("cortex-m0plus: ZD_SMALL", "cortex-m0plus", ("-DZD_SMALL",)),
    Way("cortex-m0plus: portable", "cortex-m0plus", ("-DZD_NO_ASSEMBLY",)),
    Way("rv32imc: ZD_SMALL", "rv32imc", ("-DZD_SMALL",)),
)

_CORES_ANY = (
    Way("cortex-m4: ZD_SMALL", "cortex-m4", ("-DZD_SMALL",)),
    Way("cortex-m4: aligned", "cortex-m4", ("-mno-unaligned-access",)),
    Way("cortex-m4: intrinsics", "cortex-m4", ("-DZD_NO_ASSEMBLY",)),
    Way("cortex-m0plus: ZD_SMALL", "cortex-m0plus", ("-DZD_SMALL",)),
    Way("cortex-m0plus: portable", "cortex-m0plus", ("-DZD_NO_ASSEMBLY",)),
)
"""Of a network without a kernel for each core: tables, assembly, and the C beside it."""


def list_host_ways(model: IntegerModel) -> tuple[Way, ...]:
    """Return the ways beside the default one that a model's C can be compiled on a host."""
    if _is_fast(model):
        return _HOST_FAST + _HOST_ANY
    return (_ROWS, *_HOST_ANY) if model.recurrents else _HOST_ANY


def list_core_ways(model: IntegerModel) -> tuple[Way, ...]:
    """Return the ways on emulated cores: each core as it is, then its other kernels."""
    plain = tuple(Way(core, core) for core in list_emulated())
    if _is_fast(model):
        return plain + _CORES_FAST
    bends = bool(model.recurrents) or any(TANH in node.parts for node in model.nodes)
    return plain + _CORES_ANY if bends else plain


def _is_fast(model: IntegerModel) -> bool:
    """Tell whether some recurrent layer's weights lie in the order of every kernel."""
    layer = model.recurrent
    if layer is None:
        return False
    return any(has_fast_kernels(gru) for gru in (*getattr(layer, "lower", ()), layer.gru))


def why_no_emulator() -> str:
    """Return what is missing for emulated cores; "" if nothing is."""
    for module in ("unicorn", "elftools"):
        if importlib.util.find_spec(module) is None:
            return f"{module} is not installed"
    return ""


def is_x86_64() -> bool:
    """Tell whether this host has SSE2."""
    return platform.machine().lower() in ("x86_64", "amd64")
