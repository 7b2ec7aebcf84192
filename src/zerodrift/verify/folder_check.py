"""Builds the C of a firmware folder, and nothing else, in every way there is, and runs it."""

import re
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path

import numpy as np

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.compilers import (
    RUNTIME_FILES,
    SANITIZE,
    Compiler,
    can_sanitize,
    find_compilers,
)
from zerodrift.c_runtime.cores import find_cross_compilers, list_emulated
from zerodrift.c_runtime.host import HostModel, render_sources
from zerodrift.codegen.generate import GeneratedCode, generate_again
from zerodrift.codegen.identity import (
    identify_again,
    identify_runtime,
    read_code_identities,
    read_runtime_identity,
)
from zerodrift.export.integer_model import FLAG_DAMAGED, FLAG_WARMING_UP, IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray
from zerodrift.verify.firmware_check import check_onnx
from zerodrift.verify.header import add_questions, check_header, has_avx2
from zerodrift.verify.header_finding import HeaderFinding
from zerodrift.verify.host_check import check_host
from zerodrift.verify.manifest import NotChecked
from zerodrift.verify.mismatch import Expected
from zerodrift.verify.onnx_model import OnnxModel
from zerodrift.verify.trial import HostSequence, HostTrial, find_other, try_host
from zerodrift.verify.ways import (
    HOST,
    Way,
    is_x86_64,
    list_core_ways,
    list_host_ways,
    why_no_emulator,
)

# Checks the C besides stepping: the warm-up flag, a damaged state, save and restore.

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


# Builds the C of a firmware folder, and nothing else, in every way there is, and runs it.

Progress = Callable[[str], None]

STANDARD = ("-std=c99",)
"""What any C of a firmware is compiled by; warnings are the generator's matter."""
COLD_STEPS = 2000
"""Of each random sequence, after init rather than settle."""
_FORMAT = re.compile(r"_FORMAT \d+")
SANITIZER = "sanitizer"
"""What the other layouts on the host are built with, so that undefined behaviour ends them."""
AT_ONCE = 2
"""Compilers that run at the same time."""


@dataclass
class FolderCheck:
    """What ran, what differed, what could not run; filled in as it goes."""

    vectors: int = 0
    """Steps compared on the host, each with all nodes, states, flags and drifts."""
    backends: list[str] = field(default_factory=lambda: ["reference"])
    failures: list[str] = field(default_factory=list)
    header: list[HeaderFinding] = field(default_factory=list)
    not_checked: list[NotChecked] = field(default_factory=list)


def check_folder(
    model: IntegerModel,
    code: GeneratedCode,
    golden: tuple[Expected, ...],
    sequences: Mapping[str, CodeArray],
    onnx: bytes,
    scratch: Path,
    progress: Progress = lambda _: None,
) -> FolderCheck:
    """Hold the C of a folder, and an integer ONNX, against the reference.

    Args:
        model: the integer model.
        code: the folder's C with its runtime, and the model's harness.
        golden: what every way has to give.
        sequences: name -> raw codes [T, C], for host and ONNX.
        onnx: the file.
        scratch: an empty folder for sources and programs.
        progress: is told what is being done.
    """
    check = FolderCheck()
    check.failures += compare_texts(code, generate_again(model, code))
    plain = _check_host(check, model, code, golden, sequences, scratch, progress)
    _check_onnx(check, model, onnx, golden, sequences, plain, progress)
    if plain is not None or not find_compilers():  # what already fails here is told once
        _check_cores(check, model, code, golden, scratch, progress)
    return check


def _check_host(
    check: FolderCheck,
    model: IntegerModel,
    code: GeneratedCode,
    golden: tuple[Expected, ...],
    sequences: Mapping[str, CodeArray],
    scratch: Path,
    progress: Progress,
) -> HostModel | None:
    """Run every layout on the host; return the build as it is flashed, if it is sound."""
    compilers = find_compilers()
    if not compilers:
        why = "no C compiler was found ($CC, gcc, clang, cc, ziglang)"
        check.not_checked += [NotChecked(HOST, why), NotChecked("header", why)]
        return None
    compiler = compilers[0]
    progress(f"compiling for the host with {compiler.name}")
    asking = replace(code, harness=add_questions(model, code))
    try:
        observed, plain = (
            _build(model, asking, scratch / f"host{observe}", compiler, (), observe=observe)
            for observe in (True, False)
        )
    except CheckError as error:
        check.failures.append(f"host: {_tell_compiler(error, scratch)}")
        return None
    check.header += check_header(model, code.prefix, plain.library, code.named)
    drawn = _list_stretches(sequences)
    answers = None
    for name, host in ((HOST, observed), ("host as flashed", plain)):
        answers = _hold(check, name, host, golden, drawn)
        if answers is None:
            return None
    progress("comparing random sequences")
    for name, codes in sequences.items():
        for settled in (True, False):
            part = codes if settled else codes[:COLD_STEPS]
            for backend, host in ((HOST, observed), ("host as flashed", plain)):
                mismatch = check_host(host, part, settled=settled).mismatch
                if mismatch is not None:
                    check.failures.append(f"{backend}, sequence '{name}', {mismatch}")
                    return None
            check.vectors += len(part)
    check.failures += (f"host: {what}" for what in check_behaviour(plain, golden[0].codes))
    _compare_afresh(check, model, code, plain, golden[0].codes, scratch, compiler)
    check.backends.append(HOST)
    ways = [way for way in list_host_ways(model) if _can_run(check, way, observed)]
    flags: tuple[str, ...] = ()
    if can_sanitize(compiler, scratch):
        flags = SANITIZE
    else:
        why = f"{compiler.name} does not build for it: undefined behaviour goes unseen"
        check.not_checked.append(NotChecked(SANITIZER, why))

    def build(way: Way) -> HostModel | CheckError:
        try:
            return _build(model, code, scratch / way.name, compiler, (*way.flags, *flags))
        except CheckError as error:
            return error

    progress(f"compiling {len(ways)} other layouts for the host")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for way, built in zip(ways, pool.map(build, ways), strict=True):
            if isinstance(built, CheckError):
                check.failures.append(f"{way.name}: {_tell_compiler(built, scratch)}")
            elif _agrees(check, way.name, _hold(check, way.name, built, golden, drawn), answers):
                check.backends.append(way.name)
    return plain


def _build(
    model: IntegerModel,
    code: GeneratedCode,
    folder: Path,
    compiler: Compiler,
    flags: tuple[str, ...],
    *,
    observe: bool = True,
) -> HostModel:
    flags = ("-O1", *flags)
    return HostModel(model, code, folder, compiler, flags, observe=observe, warnings=STANDARD)


def is_generated(code: GeneratedCode, fresh: GeneratedCode) -> bool:
    """Tell whether C is, to the byte, what this version of zerodrift writes for its model.

    Args:
        code: as it lies in its folder.
        fresh: what is generated now of the same model.
    """
    expected = {
        **{path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES},
        **render_sources(fresh),
    }
    return all(expected.get(name) == text for name, text in render_sources(code).items())


def compare_texts(code: GeneratedCode, fresh: GeneratedCode) -> list[str]:
    """Return where files differ from what their own identity stands for.

    Header and source carry a number that is a hash of their text, and so do the runtime's files.
    Where it is that of what is generated now, the differing line is told; C of another version has
    to have the text that its own number was made of. C from before identities has none.
    """
    there = code.runtime or {}
    runtime = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
    found: list[str] = []
    own = read_code_identities(code.header)
    if own == read_code_identities(fresh.header):
        found += _compare_lines(code.header_name, code.header, fresh.header)
        found += _compare_lines(code.source_name, code.source, fresh.source)
    elif own and read_code_identities(
        *identify_again(code.header, code.source)
    ) != read_code_identities(code.header, code.source):
        found.append(
            f"header: {code.prefix.upper()}_CODE_ID is {own[0]}; the text of {code.header_name} and"
            f" {code.source_name} gives another: they were changed"
        )
    named = {name: text for name, text in there.items() if "ZD_RUNTIME_ID" in text}
    identity = read_runtime_identity(named)
    if identity == read_runtime_identity(runtime):
        for name in sorted(there.keys() & runtime):
            found += _compare_lines(name, there[name], runtime[name])
    elif identity and identify_runtime(named) != named:
        found.append(
            f"header: ZD_RUNTIME_ID is {identity}; the text of the zd_ files gives another: they"
            " were changed"
        )
    return found


def _compare_lines(name: str, text: str, expected: str) -> list[str]:
    """Return the first line that differs, or nothing."""
    lines = zip_longest(text.split("\n"), expected.split("\n"), fillvalue="")
    for number, (line, wanted) in enumerate(lines, 1):
        if line != wanted:
            told = f"'{line.strip()[:80]}' where '{wanted.strip()[:80]}' was generated"
            return [f"{name}:{number}: {told}"]
    return []


def _compare_afresh(
    check: FolderCheck,
    model: IntegerModel,
    code: GeneratedCode,
    plain: HostModel,
    codes: CodeArray,
    scratch: Path,
    compiler: Compiler,
) -> None:
    """Hold what the C does with damage against C that is generated now, where their states agree.

    No reference says what a state is refused for. Of another version it may be something else.
    """
    fresh = generate_again(model, code)
    if _FORMAT.findall(fresh.header) == _FORMAT.findall(code.header):
        built = _build(model, fresh, scratch / "fresh", compiler, (), observe=False)
        if built.state_bytes == plain.state_bytes:
            told = compare_behaviour(plain, built, codes)
            check.failures += [f"host: {told}"] if told else []
            return
    why = "the firmware is of another version, whose states lie otherwise"
    check.not_checked.append(NotChecked("every damaged state", why))


def _tell_compiler(error: CheckError, scratch: Path) -> str:
    """Return the compiler's first complaint, files named as in the firmware's folder."""
    lines = str(error).splitlines()
    told = next((line for line in lines[1:] if "error" in line), lines[-1])
    return "does not compile: " + re.sub(rf"{re.escape(str(scratch))}/(host\w+/|[^/]+/)?", "", told)


def _can_run(check: FolderCheck, way: Way, host: HostModel) -> bool:
    """Tell whether this host runs a way; what it does not is noted."""
    if way.needs and not is_x86_64():
        check.not_checked.append(NotChecked(way.name, "this host is no x86-64"))
        return False
    if way.needs == "avx2" and not has_avx2(host.library):
        check.not_checked.append(NotChecked(way.name, "this host's processor has no AVX2"))
        return False
    return True


def _list_stretches(sequences: Mapping[str, CodeArray]) -> tuple[HostSequence, ...]:
    """Return what every layout on the host runs over beside the golden vectors."""
    settled = [HostSequence(f"sequence '{name}'", codes, True) for name, codes in sequences.items()]
    cold = [
        HostSequence(f"sequence '{name}' after init", codes[:COLD_STEPS], False)
        for name, codes in sequences.items()
    ]
    return (*settled, *cold)


def _hold(
    check: FolderCheck,
    name: str,
    host: HostModel,
    golden: tuple[Expected, ...],
    drawn: tuple[HostSequence, ...],
) -> HostTrial | None:
    """Try a host build and compare it with the reference on the golden vectors.

    Returns what it answered, or None where it differs or fails, which is noted.
    """
    stretches = [HostSequence("sequence 'golden'", e.codes, e.settled) for e in golden]
    trial = try_host(host, [*stretches, *drawn], damages=True)
    if trial.ended:
        check.failures.append(f"{name}: {trial.ended}")
        return None
    for expected in golden:
        trace = host.run(expected.codes, settled=expected.settled)
        nodes = trace.nodes if host.observes else None
        mismatch = expected.compare(trace.drift, trace.flags, nodes)
        if mismatch is not None:
            check.failures.append(f"{name}, sequence 'golden', {mismatch}")
            return None
    if host.selftest() != 0:
        check.failures.append(f"{name}: the self-test fails")
        return None
    return trial


def _agrees(
    check: FolderCheck, name: str, trial: HostTrial | None, flashed: HostTrial | None
) -> bool:
    """Tell whether a layout answers as the C does that is flashed; note where it does not."""
    if trial is None or flashed is None:
        return False
    other = find_other(trial, flashed)
    if other:
        check.failures.append(f"{name}: answers {other} otherwise than the C as flashed")
    return not other


def _check_onnx(
    check: FolderCheck,
    model: IntegerModel,
    content: bytes,
    golden: tuple[Expected, ...],
    sequences: Mapping[str, CodeArray],
    plain: HostModel | None,
    progress: Progress,
) -> None:
    """Run build/integer.onnx as it lies there."""
    progress("running the integer ONNX")
    try:
        runtime = OnnxModel(model, observe=False, content=content)
        for expected in golden:
            trace = runtime.run(expected.codes[None], settled=expected.settled)
            mismatch = expected.compare(trace.drift[0], trace.flags[0])
            if mismatch is not None:
                check.failures.append(f"onnx, sequence 'golden', {mismatch}")
                return
        for name, codes in sequences.items():
            outcome = check_onnx(runtime, plain, codes) if plain is not None else None
            if outcome is not None and outcome.mismatch is not None:
                check.failures.append(f"onnx, sequence '{name}', {outcome.mismatch}")
                return
    except CheckError as error:
        check.failures.append(f"onnx: {error}")
        return
    check.backends.append("onnx")


def _check_cores(
    check: FolderCheck,
    model: IntegerModel,
    code: GeneratedCode,
    golden: tuple[Expected, ...],
    scratch: Path,
    progress: Progress,
) -> None:
    """Run every layout on the cores that can be emulated."""
    why = why_no_emulator()
    if why:
        check.not_checked += [NotChecked(core, why) for core in list_emulated()]
        return
    ways = list_core_ways(model)
    for core in list_emulated():
        if not find_cross_compilers(core):
            check.not_checked.append(NotChecked(core, "no compiler for it: ziglang or GNU"))
            ways = tuple(way for way in ways if way.core != core)

    def run(way: Way) -> list[str]:
        progress(f"running on an emulated {way.name}")
        return _run_core(model, code, way, golden, scratch / way.name)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        for way, failures in zip(ways, pool.map(run, ways), strict=True):
            check.failures += failures
            if not failures:
                check.backends.append(way.name)


def _run_core(
    model: IntegerModel,
    code: GeneratedCode,
    way: Way,
    golden: tuple[Expected, ...],
    folder: Path,
) -> list[str]:
    """Return what differs on one emulated core; drift, flags and states after every step."""
    from zerodrift.c_runtime.emulator import EmulatedModel

    folder.mkdir()
    try:
        chip = EmulatedModel(model, code, way.core, folder, ("-O2", *way.flags))
    except CheckError as error:
        return [f"{way.name}: {_tell_compiler(error, folder)}"]
    try:
        for expected in golden:
            drift, flags, states = chip.trace(expected.codes, settled=expected.settled)
            mismatch = expected.compare(drift, flags, states=states)
            if mismatch is not None:
                return [f"{way.name}, sequence 'golden', {mismatch}"]
        if chip.selftest() != 0:
            return [f"{way.name}: the self-test fails"]
    except CheckError as error:
        return [f"{way.name}: {error}"]
    return []
