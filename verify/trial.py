"""Runs a host build in a process of its own first, should its C crash or never end."""

import subprocess
import sys
from pathlib import Path

from zerodrift.c_runtime.host import HostModel
from zerodrift.operations.arithmetic import CodeArray

LONGEST_S = 120
_PROGRAM = """
import ctypes, sys
library, codes, outputs, values, settled = sys.argv[1:6]
raw = open(codes, "rb").read()
steps = int(sys.argv[6])
lib = ctypes.CDLL(library)
for name in ("zd_state_size", "zd_selftest"):
    getattr(lib, name).restype = ctypes.c_uint32
state = ctypes.create_string_buffer(lib.zd_state_size() + 4096)
drift = ctypes.create_string_buffer(4 * steps * int(outputs) + 4096)
flags = ctypes.create_string_buffer(4 * steps + 4096)
nodes = ctypes.create_string_buffer(4 * steps * int(values) + 4096)
lib.zd_start(state, raw, ctypes.c_int(int(settled)))
lib.zd_run(state, raw, ctypes.c_uint32(steps), drift, flags, nodes if int(values) else None)
lib.zd_selftest()
"""


def try_host(host: HostModel, codes: CodeArray, *, settled: bool) -> str:
    """Return how a host build fails on codes [T, C], by a signal or never ending; "" if it ends.

    Args:
        host: the build.
        codes: raw input codes.
        settled: start from `settle` rather than `init`.
    """
    path = Path(f"{host.library}.codes")
    path.write_bytes(codes.astype(host.model.code_type).tobytes())
    numbers = (len(host.model.outputs), host.values, int(settled), len(codes))
    command = [sys.executable, "-I", "-c", _PROGRAM, str(host.library), str(path)]
    try:
        done = subprocess.run(
            [*command, *map(str, numbers)], capture_output=True, check=False, timeout=LONGEST_S
        )
    except subprocess.TimeoutExpired:
        return f"did not end within {LONGEST_S} s"
    if done.returncode < 0:
        return f"was ended by signal {-done.returncode}"
    if done.returncode:
        return (
            f"ended with exit code {done.returncode}: {done.stderr.decode(errors='replace')[-300:]}"
        )
    return ""
