"""The tables by which the C converts raw codes, read out of its text for the error bound.

A statement that is not written as the generator writes it is refused, so that what stands here is
what the C computes. Shares no code with the generator and needs the standard library only.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from zerodrift_proof.certificate.values import Block, NotUnderstoodError

NUMBER = r"(?:-? ?\d+|\( - 2147483647 - 1 \))"
LOOK_UP = (
    r"const int32_t {n}_code = zd_clamp32 \( (?P<given>[\w >-]+?) , (?P<low>N) , (?P<high>N) \) ; "
    r"const uint32_t {n}_place = \( uint32_t \) \( \( int64_t \) {n}_code - \( (?P<base>N) \) \) ; "
    r"const uint32_t {n}_block = {n}_place >> (?P<bits>\d+) ; "
    r"const int32_t {n}_parts = zd_clamp32 \( \( int32_t \) {n}_first \[ {n}_block \+ 1u \]"
    r" - {n}_first \[ {n}_block \] , 1 , (?P<most>\d+) \) ; "
    r"const uint32_t {n}_at = \( {n}_place & (?P<mask>\d+)u \) \* \( uint32_t \) {n}_parts ; "
    r"const int32_t {n}_line = zd_clamp32 \( {n}_first \[ {n}_block \]"
    r" \+ \( int32_t \) \( {n}_at >> (?P<bits2>\d+) \) , 0 , (?P<last>\d+) \) ; "
    r"const int32_t {n} = \( int32_t \) zd_clamp64 \( zd_asr64 \( INT64_C \( (?P<half>\d+) \)"
    r" \+ \( \( int64_t \) {n}_nodes \[ {n}_line \] \* INT64_C \( (?P<width>\d+) \) \)"
    r" \+ \( \( \( int64_t \) {n}_nodes \[ {n}_line \+ 1 \] - {n}_nodes \[ {n}_line \] \)"
    r" \* \( int64_t \) \( {n}_at & (?P<mask2>\d+)u \) \) , (?P<shift>\d+)u \) ,"
    r" (?P<lowest>N) , (?P<highest>N) \) ;"
).replace("N)", f"{NUMBER})")
SUM = (
    r"const int32_t {n}_sum = \( int32_t \) zd_clamp64 \( \( \( int64_t \) in -> {f} \* (\d+) \)"
    r" \+ (\w+) , \( - 2147483647 - 1 \) , 2147483647 \) ;"
)
PLAIN = r"now -> {f} = (?:\( int16_t \) )?(?:\( [^;?]+ \) \? N : )?\(?in -> {f}\)? ;".replace(
    "N", NUMBER
)
LOOKED_UP = (
    r"now -> {f} = (?:\( int16_t \) ?)?(?:\( )?(?:\( [^;?]+ \) \? N : )?(conversion_\w+)(?: \))? ;"
).replace("N", NUMBER)


@dataclass(frozen=True)
class LookUp:
    """A table: what its lines give over what is looked up, rounded to integers."""

    name: str
    low: int
    high: int
    """What is looked up is limited to these."""
    bits: int
    first: tuple[int, ...]
    nodes: tuple[int, ...]
    shift: int
    lowest: int
    highest: int


@dataclass(frozen=True)
class FieldConversion:
    """How a field of the inputs becomes the code that the model reads."""

    table: LookUp | None
    """None: the code is what is given."""
    junction: LookUp | None = None
    """Of a thermocouple's cold junction."""
    junction_field: str = ""
    factor: int = 1
    """Of the raw code in the sum with the junction's voltage."""


@dataclass(frozen=True)
class _LookUpNumbers:
    """The numbers that stand in a look-up; those that stand there twice have a 2 behind."""

    low: int
    high: int
    base: int
    bits: int
    bits2: int
    most: int
    mask: int
    mask2: int
    last: int
    half: int
    width: int
    shift: int
    lowest: int
    highest: int


def read_conversions(
    words: Sequence[str], prefix: str, constants: Mapping[str, object]
) -> dict[str, FieldConversion]:
    """Return field -> its conversion; empty where the model is given its codes as they are.

    Args:
        words: the tokens of the C.
        prefix: of the model.
        constants: name -> block of numbers.

    Raises:
        NotUnderstoodError: a statement that is written in another way.
    """
    text = " ".join(words)
    given = f"{prefix}_codes_t * now , const {prefix}_input_t * in"
    head = f"static void {prefix}_convert ( {given} ) {{ "
    begin = text.find(head)
    if begin < 0:
        if f" {prefix}_convert " in text:
            raise NotUnderstoodError("codes are converted in another way")
        return {}
    body = text[begin + len(head) : text.index(" }", begin + len(head)) + 1]
    found: dict[str, FieldConversion] = {}
    for field in re.findall(r"now -> (\w+) = ", body):
        found[field] = _read_field(body, field, constants)
    return found


def _read_field(body: str, field: str, constants: Mapping[str, object]) -> FieldConversion:
    if body.count(f"now -> {field} = ") != 1:
        raise NotUnderstoodError(f"{field} is converted twice")
    if re.search(PLAIN.format(f=field), body):
        return FieldConversion(None)
    at = re.search(LOOKED_UP.format(f=field), body)
    if at is None:
        raise NotUnderstoodError(f"{field} is converted in another way")
    name = at[1]
    given, table = _read_table(body, name, constants)
    if given == f"in -> {field}":
        return FieldConversion(table)
    summed = re.search(SUM.format(n=name, f=field), body)
    if given != f"{name}_sum" or summed is None:
        raise NotUnderstoodError(f"{name} looks up something else")
    cold, junction = _read_table(body, summed[2], constants)
    if not cold.startswith("now -> ") or body.index(f"{cold} = ") > body.index(f"{summed[2]}_code"):
        raise NotUnderstoodError(f"{name}: its cold junction is not converted before")
    return FieldConversion(table, junction, cold.removeprefix("now -> "), int(summed[1]))


def _read_table(body: str, name: str, constants: Mapping[str, object]) -> tuple[str, LookUp]:
    """Return what is looked up, and the table."""
    match = re.search(LOOK_UP.replace("{n}", name), body)
    if match is None or body.count(f"const int32_t {name} = ") != 1:
        raise NotUnderstoodError(f"{name} is looked up in another way")
    numbers = {key: _read(text) for key, text in match.groupdict().items() if key != "given"}
    told = _LookUpNumbers(**numbers)
    first, nodes = (_cells(constants, f"{name}_{part}") for part in ("first", "nodes"))
    bits, parts = told.bits, [after - before for before, after in pairwise(first)]
    blocks = (told.high - told.low >> bits) + 1
    sound = (
        told.base == told.low <= told.high
        and told.bits2 == bits <= 31
        and told.mask == told.mask2 == told.width - 1 == (1 << bits) - 1
        and told.half == 1 << told.shift >> 1
        and told.shift >= bits
        and len(first) == blocks + 1
        and first[0] == 0
        and min(parts) >= 1
        and max(parts) <= told.most
        and max(parts) << bits <= 1 << 32
        and first[-1] == told.last + 1 == len(nodes) - 1
    )
    if not sound:
        raise NotUnderstoodError(f"{name}: its numbers make no table")
    limits = (told.lowest, told.highest)
    table = LookUp(name, told.low, told.high, bits, first, nodes, told.shift, *limits)
    return match["given"], table


def _read(text: str) -> int:
    return -(2**31) if text.startswith("(") else int(text.replace(" ", ""))


def _cells(constants: Mapping[str, object], name: str) -> tuple[int, ...]:
    block = constants.get(name)
    if not isinstance(block, Block):
        raise NotUnderstoodError(f"no table {name}")
    cells = tuple(cell for cell in block.cells if isinstance(cell, int))
    if len(cells) != block.count:
        raise NotUnderstoodError(f"{name} is no table of numbers")
    return cells
