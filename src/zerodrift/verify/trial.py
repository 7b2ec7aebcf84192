"""Runs a host build in a separate process first, in case its C crashes, traps or never ends."""

import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zerodrift.c_runtime.host import SAVED_EXTRA_BYTES, HostModel
from zerodrift.operations.arithmetic import CodeArray

LONGEST_S = 120
TRAPS = (4, 5)
"""Signals by which what a compiler's sanitizer put there ends a program: SIGILL, SIGTRAP."""
_PROGRAM = Path(__file__).with_name("trial_child.py")


@dataclass(frozen=True)
class HostSequence:
    """A sequence and what it starts from."""

    name: str
    codes: CodeArray
    """[T, C]."""
    settled: bool
    """From `settle` rather than `init`."""


@dataclass(frozen=True)
class HostTrial:
    """What became of a host build in a process of its own."""

    ended: str
    """How it failed and over what, by a signal or never ending; "" if it came to its end."""
    answers: tuple[str, ...] = ()
    """Each stretch, the self-test and the damaged states, with a checksum of drifts, flags and
    states; the same for the same bits."""


def try_host(
    host: HostModel, stretches: Sequence[HostSequence], *, damages: bool = False
) -> HostTrial:
    """Run a host build over some stretches, and over damaged and random states.

    Args:
        host: the build.
        stretches: what it runs over, at least one.
        damages: states of which a byte or a word is another, and random ones, are stepped, saved
            and restored as well.
    """
    path = Path(f"{host.library}.job")
    codes = [np.ascontiguousarray(s.codes, dtype=host.model.code_type) for s in stretches]
    path.with_suffix(".codes").write_bytes(b"".join(part.tobytes() for part in codes))
    job = {
        "library": str(host.library),
        "prefix": host.prefix,
        "outputs": len(host.model.outputs),
        "values": host.values,
        "saved_extra": SAVED_EXTRA_BYTES,
        "row_bytes": codes[0].shape[1] * codes[0].itemsize,
        "stretches": [[s.name, len(s.codes), int(s.settled)] for s in stretches],
        "damages": damages,
    }
    path.write_text(json.dumps(job), encoding="utf-8")
    try:
        done = subprocess.run(
            [sys.executable, "-I", str(_PROGRAM), str(path)],
            capture_output=True,
            check=False,
            timeout=LONGEST_S,
        )
    except subprocess.TimeoutExpired as error:
        return HostTrial(_tell(error.stdout, f"did not end within {LONGEST_S} s"))
    if done.returncode < 0:
        return HostTrial(_tell(done.stdout, _name_signal(-done.returncode)))
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip()[-300:]
        return HostTrial(_tell(done.stdout, f"ended with exit code {done.returncode}: {said}"))
    lines = done.stdout.decode().splitlines()
    return HostTrial("", tuple(line[2:] for line in lines if line.startswith("= ")))


def find_other(trial: HostTrial, other: HostTrial) -> str:
    """Return the first thing that two builds answer differently; "" if there is none."""
    for one, two in zip(trial.answers, other.answers, strict=True):
        if one != two:
            return one.rpartition(" ")[0]
    return ""


def _name_signal(number: int) -> str:
    traps = " (undefined behaviour)" if number in TRAPS else ""
    return f"was ended by signal {number}{traps}"


def _tell(printed: bytes | None, how: str) -> str:
    lines = (printed or b"").decode(errors="replace").splitlines()
    named = [line for line in lines if not line.startswith("= ")]
    return f"the program {how}, over {named[-1] if named else 'its start'}"
