"""Checks the C besides stepping: the warm-up flag, a damaged state, save and restore."""

from collections.abc import Iterator

import numpy as np

from zerodrift.c_runtime.host import HostModel
from zerodrift.export.integer_model import FLAG_DAMAGED, FLAG_WARMING_UP
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray

STEPS = 24
_MOST_PLACES = 1024
"""Of a state or copy, spread over it, that are damaged and compared with fresh C."""
_COPY_HEAD = 12
"""Bytes of a saved copy before the state: version, model, size."""
_FLIPPED = 64
"""Bytes of a saved copy that are damaged, spread over it."""


def compare_behaviour(host: HostModel, fresh: HostModel, codes: CodeArray) -> str:
    """Return where a host build answers a damaged state or copy otherwise than C made afresh.

    Every byte of a state is changed in three ways: as it lies there, and in a copy whose CRC fits.
    One bit of every byte of a saved copy is changed, too. What step and restore then do must be the
    same, over a state that runs and over one that never did. States of the two must lie alike.

    Args:
        host: the source as it is flashed.
        fresh: the same model's, generated now.
        codes: [T, C] some sequence of at least 24 steps.
    """
    places = np.unique(np.linspace(0, host.state_bytes - 1, _MOST_PLACES).astype(int))
    for settled in (True, False):
        saved: list[bytes] = []
        for build in (host, fresh):
            build.overwrite(b"\xa5" * build.state_bytes)
            build.run(codes[:STEPS], settled=settled)
            saved.append(build.save())
        if saved[0] != saved[1]:
            return "save writes another copy than the model's C does"
        state = saved[0][_COPY_HEAD : _COPY_HEAD + host.state_bytes]
        for at in places:
            for byte in (state[at] ^ 0x80, 0x7F, state[at] ^ 1):
                damaged = state[:at] + bytes([byte]) + state[at + 1 :]
                found = []
                for build in (host, fresh):
                    build.overwrite(damaged)
                    copy = build.save()
                    trace = build.run(codes[:2], restart=False)
                    after = build.save()
                    build.overwrite(state)
                    answer = build.restore(copy), build.save()
                    found.append((trace.drift.tolist(), trace.flags.tolist(), after, answer))
                if found[0] != found[1]:
                    return f"a state whose byte {at} is 0x{byte:02x} is answered otherwise"
        for at in np.unique(np.linspace(0, len(saved[0]) - 1, _MOST_PLACES).astype(int)):
            spoilt = bytearray(saved[0])
            spoilt[at] ^= 1 << (at % 8)
            answers: list[list[tuple[int, bytes]]] = []
            for build in (host, fresh):
                answers.append([])
                for before in (b"\xa5" * build.state_bytes, state):
                    build.overwrite(before)
                    answers[-1].append((build.restore(bytes(spoilt)), build.save()))
            if answers[0] != answers[1]:
                return f"a copy whose byte {at} is damaged is answered otherwise"
    return ""


def check_behaviour(host: HostModel, codes: CodeArray) -> tuple[str, ...]:
    """Return what a plain host build does otherwise than the header promises.

    Args:
        host: the source as it is flashed, already held against the reference.
        codes: [T, C] some sequence of at least 2 x 24 steps.
    """
    found = (*_check_warm_up(host, codes), *_check_damage(host, codes), *_check_copies(host, codes))
    return (*found, *_check_tare(host, codes), *_check_sleep(host, codes))


def _check_warm_up(host: HostModel, codes: CodeArray) -> Iterator[str]:
    steps = host.model.guards.warm_up_steps
    constant = np.repeat(codes[:1], steps + 8, axis=0)
    flagged = (host.run(constant, settled=False).flags & FLAG_WARMING_UP) != 0
    if not (flagged == (np.arange(len(constant)) < steps)).all():
        yield f"warming up is flagged on {int(flagged.sum())} steps after init, not on {steps}"


def _check_tare(host: HostModel, codes: CodeArray) -> Iterator[str]:
    """Drift counts from the last answer on, saved and restored too, and from 0 again after."""
    if not host.model.tare:
        return
    reference = Reference(host.model)
    state = reference.run(codes[None, :STEPS]).state
    parts = [codes[k * STEPS // 2 : (k + 1) * STEPS // 2] for k in (2, 3)]
    host.run(codes[:STEPS])
    for name, act, change in (
        ("tare", host.tare, reference.take_tare),
        ("untare", host.untare, reference.release_tare),
    ):
        act()
        state = change(state)
        if host.restore(host.save()) != 0:
            yield f"restore refuses a state after {name}"
        found, expected = (
            host.run(parts[0], restart=False),
            reference.run(parts[0][None], state=state),
        )
        if (found.drift != expected.drift[0]).any() or (found.flags != expected.flags[0]).any():
            yield f"drifts or flags after {name} are others than the reference's"
        state = expected.state
        parts.reverse()
    host.run(codes[:1], settled=False)
    host.overwrite(bytes(host.state_bytes))
    host.tare()
    if host.save()[_COPY_HEAD:-4] != bytes(host.state_bytes):
        yield "tare changes a state that was never started"


def _check_sleep(host: HostModel, codes: CodeArray) -> Iterator[str]:
    """A state that is restored with an age goes on as after a longer step."""
    if not host.model.variable_step:
        return
    reference = Reference(host.model)
    state = reference.run(codes[None, :STEPS]).state
    then = codes[STEPS : 2 * STEPS]
    for age_us in (0, host.model.period_us, 10**10, 2**64 - 1):
        host.run(codes[:STEPS])
        if host.restore_after(host.save(), age_us) != 0:
            yield "restore_after refuses what save wrote"
        found = host.run(then, restart=False)
        expected = reference.run(then[None], state=reference.sleep(state, age_us))
        if (found.drift != expected.drift[0]).any() or (found.flags != expected.flags[0]).any():
            yield f"a state restored after {age_us} us goes on otherwise than the reference's"


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
