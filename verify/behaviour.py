"""What the C does beside stepping: the warm-up flag, a damaged state, save and restore."""

from collections.abc import Iterator

import numpy as np

from zerodrift.c_runtime.host import HostModel
from zerodrift.export.integer_model import FLAG_DAMAGED, FLAG_WARMING_UP
from zerodrift.operations.arithmetic import CodeArray

STEPS = 24
_FLIPPED = 64
"""Bytes of a saved copy that are damaged, spread over it."""


def check_behaviour(host: HostModel, codes: CodeArray) -> tuple[str, ...]:
    """Return what a plain host build does otherwise than the header promises.

    Args:
        host: the source as it is flashed, already held against the reference.
        codes: [T, C] some sequence of at least 2 x 24 steps.
    """
    return (*_check_warm_up(host, codes), *_check_damage(host, codes), *_check_copies(host, codes))


def _check_warm_up(host: HostModel, codes: CodeArray) -> Iterator[str]:
    steps = host.model.guards.warm_up_steps
    constant = np.repeat(codes[:1], steps + 8, axis=0)
    flagged = (host.run(constant, settled=False).flags & FLAG_WARMING_UP) != 0
    if not (flagged == (np.arange(len(constant)) < steps)).all():
        yield f"warming up is flagged on {int(flagged.sum())} steps after init, not on {steps}"


def _check_damage(host: HostModel, codes: CodeArray) -> Iterator[str]:
    """A state of zeros or of ones was never started: no drift, flagged, then a cold start."""
    cold = host.run(codes[:STEPS], settled=False)
    for fill in (b"\x00", b"\xff"):
        host.run(codes[:STEPS])
        host.overwrite(fill * host.state_bytes)
        first = host.run(codes[:1], restart=False)
        if first.flags[0] != FLAG_DAMAGED or first.drift.any():
            yield f"a state of bytes 0x{fill.hex()} is not answered by the flag DAMAGED and drift 0"
            continue
        again = host.run(codes[:STEPS], restart=False)
        if (again.flags != cold.flags).any() or (again.drift != cold.drift).any():
            yield f"after a state of bytes 0x{fill.hex()} there is no cold start"


def _check_copies(host: HostModel, codes: CodeArray) -> Iterator[str]:
    first, then = codes[:STEPS], codes[STEPS : 2 * STEPS]
    host.run(first)
    saved = host.save()
    expected = host.run(then, restart=False)
    host.run(codes[:1], settled=False)
    if host.restore(saved) != 0:
        yield "restore refuses what save wrote"
        return
    found = host.run(then, restart=False)
    if (found.drift != expected.drift).any() or (found.flags != expected.flags).any():
        yield "a restored state does not go on as the saved one"
    cold = host.run(then, settled=False)
    for at in np.unique(np.linspace(0, len(saved) - 1, _FLIPPED).astype(int)):
        damaged = bytearray(saved)
        damaged[at] ^= 0x10
        host.run(first)
        if host.restore(bytes(damaged)) == 0:
            yield f"restore takes a copy whose byte {at} is damaged"
            return
        found = host.run(then, restart=False)
        if (found.drift != cold.drift).any() or (found.flags != cold.flags).any():
            yield f"after a copy whose byte {at} is damaged there is no cold start"
            return
