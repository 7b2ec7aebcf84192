"""Derives every bound of a certificate again from the generated C alone, and compares.

certificate.json as the checker reads it: by itself, as it shares no code with the writer.

What a header tells its caller to index `drift[]` by, held against the array that is written.

The C is run once over intervals (`intervals`). The runtime's kernels are taken at their
specification (docs/reference/integer-arithmetic.md), their constants and table from zd_runtime.h
and .c.
"""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift_proof.bound.check import check_bound
from zerodrift_proof.certificate.guard import FIELD as SUM
from zerodrift_proof.certificate.intervals import IntervalMachine
from zerodrift_proof.certificate.model import Model, read_models
from zerodrift_proof.certificate.values import (
    TYPES,
    FaultError,
    NotUnderstoodError,
    anything,
)
from zerodrift_proof.known_runtime import is_known


@dataclass(frozen=True)
class Claim:
    """A range of integers, and what it is claimed of."""

    where: str
    low: int
    high: int


@dataclass(frozen=True)
class BoundClaim(Claim):
    """The range of a sum, and the bits of the variable that holds it."""

    bits: int


@dataclass(frozen=True)
class BlockClaim(Claim):
    """What each number of a field of a block can be, and its rows add up to."""

    row: int
    """Numbers in a row; 0: nothing is claimed of rows."""
    norm: int
    layer: tuple[int, int, int]
    """Units of a GRU no sum of which leaves 32 bits, words of its rows of features and of state."""


@dataclass(frozen=True)
class TableClaim(Claim):
    """The range of what is read of a table, and the lines that can be read."""

    lines: int


@dataclass(frozen=True)
class CertificateClaims:
    """All claims about a model and its C."""

    model: str
    """Hash of the integer model."""
    prefix: str
    files: Mapping[str, str]
    """Name -> SHA-256."""
    inputs: tuple[Claim, ...]
    """Channel and the codes that it can hold."""
    checksum: object
    """The state's field that guards it; None where there is none."""
    invariants: tuple[Claim, ...]
    tables: tuple[TableClaim, ...]
    shifts: Mapping[str, int]
    """Where -> bits."""
    bounds: tuple[BoundClaim, ...]
    blocks: tuple[BlockClaim, ...]
    """Of a design; empty where the numbers are the program's own."""


def read_claims(told: Mapping[str, object]) -> CertificateClaims:
    """Return the content of certificate.json.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: it is not built like a certificate.
    """
    rows = {name: _list_rows(told[name]) for name in ("inputs", "invariants", "tables", "bounds")}
    files = told["files"]
    if not isinstance(files, dict):
        raise TypeError("files is no object")
    return CertificateClaims(
        model=_read_text(told["model"]),
        prefix=_read_text(told["prefix"]),
        files={_read_text(name): _read_text(digest) for name, digest in files.items()},
        inputs=tuple(Claim(_read_text(c["channel"]), *_read_range(c)) for c in rows["inputs"]),
        checksum=told.get("checksum"),
        invariants=tuple(
            Claim(_read_text(c["where"]), *_read_range(c)) for c in rows["invariants"]
        ),
        tables=tuple(
            TableClaim(_read_text(c["where"]), *_read_range(c), _read_integer(c["lines"]))
            for c in rows["tables"]
        ),
        shifts={
            _read_text(c["where"]): _read_integer(c["shift"]) for c in _list_rows(told["shifts"])
        },
        bounds=tuple(
            BoundClaim(_read_text(c["where"]), *_read_range(c), _read_integer(c["bits"]))
            for c in rows["bounds"]
        ),
        blocks=tuple(
            BlockClaim(
                _read_text(c["where"]),
                *_read_range(c),
                _read_integer(c.get("row", 0)),
                _read_integer(c.get("norm", 0)),
                _read_layer(c),
            )
            for c in _list_rows(told.get("blocks", []))
        ),
    )


def _list_rows(value: object) -> list[dict[str, object]]:
    if not isinstance(value, list) or not all(isinstance(row, dict) for row in value):
        raise TypeError(f"{value!r:.40} is no list of claims")
    return value


def _read_range(row: Mapping[str, object]) -> tuple[int, int]:
    return _read_integer(row["low"]), _read_integer(row["high"])


def _read_integer(value: object) -> int:
    if type(value) is not int:
        raise TypeError(f"{value!r:.40} is no integer")
    return value


def _read_layer(row: Mapping[str, object]) -> tuple[int, int, int]:
    units, x, h = (_read_integer(row.get(name, 0)) for name in ("units", "x_pairs", "h_pairs"))
    return units, x, h


def _read_text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.40} is no text")
    return value


SCALE = "_LSB_PER_UNIT"
"""Ends the name of an output's scale; without it, that of its index."""


def find_wrong_indices(macros: Mapping[str, Sequence[str]], prefix: str) -> list[str]:
    """Return what is wrong with the names of the outputs: each has to be a place of its own.

    A caller reads `drift[PREFIX_NAME]` from an array of `PREFIX_OUTPUTS`; nothing in the C itself
    uses the names. An output is what has an `_LSB_PER_UNIT`.

    Args:
        macros: of the model's header, name -> words that it stands for.
        prefix: of its names, as in the file's name.
    """
    own = f"{prefix.upper()}_"
    count = " ".join(macros.get(f"{own}OUTPUTS", ()))
    if not re.fullmatch(r"[1-9]\d*", count):
        return [f"{own}OUTPUTS: is '{count}', no number of outputs"]
    names = [name.removesuffix(SCALE) for name in macros if name.endswith(SCALE)]
    found, indices = [], []
    for name in names:
        value = " ".join(macros.get(name, ()))
        if not re.fullmatch(r"0|[1-9]\d*", value) or int(value) >= int(count):
            found.append(f"{name}: is '{value}', outside of drift[{count}]")
        else:
            indices.append(int(value))
    if sorted(indices) != list(range(int(count))):
        found.append(
            f"the outputs' indices are {sorted(indices)}; expected 0 .. {int(count) - 1}, each once"
        )
    return found


SHARED_RUNTIME = "runtime"
"""Beside the folders of a fleet's units: the runtime of all of them."""
NOT_THERE = (FileNotFoundError, NotADirectoryError, IsADirectoryError)
MALFORMED = (*NOT_THERE, ValueError, KeyError, TypeError, AttributeError, IndexError)
"""What files raise that are missing, or not built like a certificate and its C."""


@dataclass(frozen=True)
class CertificateOutcome:
    """What the check found: how many claims hold, and every one that does not."""

    holds: int
    failures: tuple[str, ...]
    understood: bool = True
    """False: the C holds something without a rule, so that nothing is shown either way."""


def check_certificate(folder: Path) -> CertificateOutcome:
    """Return what becomes of the certificate in a firmware folder, whatever is in its files.

    Raises:
        OSError: a file is there and the system does not hand it out, which says nothing of it.
    """
    try:
        claims = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
        contents = {n: find_file(folder, n).read_bytes() for n in read_claims(claims).files}
        texts = {name: content.decode() for name, content in contents.items()}
        outcome = compare(claims, texts)
        taken = tuple(find_taken_headers(folder, texts))
        return replace(outcome, failures=(*taken, *outcome.failures))
    except MALFORMED as error:
        return CertificateOutcome(
            0, (f"{folder}: not a certificate and its C ({type(error).__name__}: {error})",)
        )


def find_taken_headers(folder: Path, texts: Mapping[str, str]) -> Iterator[str]:
    """Yield what is wrong where a file of the firmware would be read as a compiler's own header.

    Args:
        folder: of the firmware, in which a compiler looks before it looks among its own.
        texts: file name -> content, of all files that are compiled.
    """
    asked = {name for text in texts.values() for name in re.findall(r"#include <(.+?)>", text)}
    for name in sorted(asked):
        if any((place / name).exists() for place in (folder, folder.parent / SHARED_RUNTIME)):
            yield (
                f"{name}: lies beside the C, where a compiler may read it in place of its own;"
                " remove it"
            )


def find_file(folder: Path, name: str) -> Path:
    """Return a file of a firmware folder; of a unit of a fleet, the runtime that all share."""
    shared = folder.parent / SHARED_RUNTIME / name
    return shared if shared.is_file() and not (folder / name).exists() else folder / name


def compare(claims: Mapping[str, object], texts: dict[str, str]) -> CertificateOutcome:
    """Hold a certificate's claims against the files they are about.

    Args:
        claims: the content of certificate.json.
        texts: file name -> content, of the model's header and source and of the runtime.
    """
    outcomes = list(judge_each(claims, texts))
    understood = all(outcome.understood for outcome in outcomes)
    failures = tuple(text for outcome in outcomes for text in outcome.failures)
    return CertificateOutcome(outcomes[-1].holds if understood else 0, failures, understood)


def judge_each(claims: Mapping[str, object], texts: dict[str, str]) -> Iterator[CertificateOutcome]:
    """Yield what becomes of the claims on the files, then of all others for each way to compile.

    It ends with the first way that is not understood. Arguments as for `compare`.
    """
    read = read_claims(claims)
    prefix, failures = read.prefix, []
    for name, digest in read.files.items():
        found = hashlib.sha256(texts[name].encode()).hexdigest()
        if found != digest:
            failures.append(f"{name}: its hash is {found[:12]}, the certificate's {digest[:12]}")
    if not is_known(texts):
        what = "the runtime (zd_*.h, zd_*.c) is no text that was compared with the reference"
        yield _refuse(failures, what)
        return
    if not {f"{prefix}.h", f"{prefix}.c"} <= {*read.files}:
        failures.append(f"the certificate is not about {prefix}.h and {prefix}.c")
    try:
        models = read_models(texts, prefix)
    except FaultError as error:
        yield CertificateOutcome(0, (*failures, str(error)))
        return
    except (NotUnderstoodError, *MALFORMED) as error:
        yield _refuse(failures, str(error))
        return
    macros = models[0].program.tokens.macros
    if macros.get(f"{prefix.upper()}_MODEL_HASH") != [f'"{read.model}"']:
        failures.append(f"{prefix}.h: does not name the certificate's model {read.model[:12]}")
    failures += [f"{prefix}.h: {text}" for text in find_wrong_indices(macros, prefix)]
    yield CertificateOutcome(0, tuple(failures))
    for model in models:  # each kernel has the weights in an order of its own
        outcome = judge_way(claims, model)
        yield outcome
        if not outcome.understood:
            return
    if isinstance(claims.get("error_bound"), list):
        yield judge_bound(claims, models[0], outcome)


def judge_bound(
    claims: Mapping[str, object], model: Model, before: CertificateOutcome
) -> CertificateOutcome:
    """Hold the error bound against what the C and the float model's parameters give.

    The numbers are those of any way to compile; each has shown them to be alike.
    """
    if before.failures:
        return before
    try:
        holds, failures = check_bound(claims, model)
    except (NotUnderstoodError, FaultError, *MALFORMED) as error:
        return _refuse([], f"error bound: {error}")
    return CertificateOutcome(before.holds + holds, tuple(failures))


def judge_way(claims: Mapping[str, object], model: Model) -> CertificateOutcome:
    """Run one way of compiling a model, and hold the claims against it."""
    try:
        model.run()
    except (NotUnderstoodError, *MALFORMED) as error:
        failures = [f"{model.name}: {text}" for text in model.failures]
        return _refuse(failures, f"{model.name}: {error}")
    holds, contradictions = judge(claims, model)
    failures = [f"{model.name}: {text}" for text in (*model.failures, *contradictions)]
    return CertificateOutcome(holds, tuple(failures))


def _refuse(failures: list[str], what: str) -> CertificateOutcome:
    text = f"{what}: there is no rule for this, so nothing is shown"
    return CertificateOutcome(0, (*failures, text), understood=False)


def judge(claims: Mapping[str, object], machine: IntervalMachine) -> tuple[int, list[str]]:
    """Return how many claims hold for what was derived, and what is wrong with the others."""
    read = read_claims(claims)
    holds, failures = 0, []
    claimed = {c.where: (c.low, c.high, c.bits) for c in read.bounds}
    for where, (low, high, bits) in claimed.items():
        found = machine.bounds.get(where)
        if found is None:
            failures.append(f"{where}: claimed, but nothing of that name is in the C")
        elif found[0] < low or found[1] > high or found[2] != bits:
            failures.append(
                f"{where}: claimed {low} .. {high} in {bits} bits, derived {found[0]} .. {found[1]}"
                f" in {found[2]}"
            )
        else:
            holds += 1
    # a variable that is no accumulator need not be claimed
    missing = [w for w in machine.bounds if w not in claimed and re.search(r"[.\[]", w)]
    failures += [f"{where}: relied on by the C, but not claimed" for where in missing]
    shifts = read.shifts
    for where in sorted({*shifts, *machine.shifts}):
        if shifts.get(where) == machine.shifts.get(where):
            holds += 1
        else:
            found_shift = machine.shifts.get(where)
            failures.append(f"{where}: claimed {shifts.get(where)}, the C has {found_shift}")
    known = {
        (f"{place}.h_q30", -machine.h_limit, machine.h_limit) for place, _ in machine.recurrent
    }
    for claim in read.invariants:
        if (claim.where, claim.low, claim.high) in known:
            holds += 1
        else:
            failures.append(f"{claim.where}: the state check admits another range than claimed")
    table = (machine.lines, -machine.tanh_max, machine.tanh_max)
    for line in read.tables:
        if (line.lines, line.low, line.high) == table:
            holds += 1
        else:
            failures.append(f"{line.where}: claimed {line}, the C has {table}")
    wrong = _judge_blocks(read, machine)
    holds += len(read.blocks) if not wrong else 0
    return holds, [*failures, *wrong, *_judge_state(read, machine)]


def _judge_blocks(claims: CertificateClaims, machine: IntervalMachine) -> list[str]:
    """Return where the set of blocks that is claimed is not the one that the C lets through."""
    tested = machine.blocks
    failures, left = [], {*tested.limits, *tested.layers}
    for claim in claims.blocks:
        name = claim.where.removeprefix("b->")
        norm, rows = tested.norms.get(name), tested.layers.get(name)
        found = (*tested.limits.get(name, ()), *((norm.row, norm.most) if norm else (0, 0)))
        if rows is not None:
            any_word = anything("int32_t")
            found = (any_word.low, any_word.high, 0, 0, rows.units, rows.x, rows.h)
        layer = claim.layer if any(claim.layer) else ()
        if found != (claim.low, claim.high, claim.row, claim.norm, *layer):
            failures.append(f"{claim.where}: claimed {claim}, the test of a block has {found}")
        left.discard(name)
    return [*failures, *(f"b->{name}: tested by the C, but not claimed" for name in sorted(left))]


def _judge_state(claims: CertificateClaims, machine: IntervalMachine) -> list[str]:
    """Return what is wrong with the claims on the inputs' codes and the state's checksum."""
    failures = []
    fields = machine.program.structs[f"{machine.prefix}_input_t"]
    own = [(f.name, *TYPES[f.type.name]) for f in fields if not f.sizes]
    claimed = [(c.where, c.low, c.high) for c in claims.inputs]
    names = {name for name, _, _ in own}
    if len(own) != len(fields) or len(own) != len(claimed):
        failures.append(f"{len(claimed)} inputs are claimed, the header has {len(fields)}")
    for (name, *codes), (channel, *ends) in zip(own, claimed, strict=False):
        if codes != ends or (channel in names and channel != name):
            failures.append(
                f"input {channel}: claimed {ends[0]} .. {ends[1]}; the header has {name} of"
                f" {codes[0]} .. {codes[1]} there"
            )
    if claims.checksum != (SUM if machine.summed else None):
        failures.append(f"checksum {claims.checksum} is claimed; the C has {machine.summed}")
    return failures
