"""A design: the fixed-point format that all of its units share, and the set of their blocks."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import IntArray
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.records import Json, from_json, to_json
from zerodrift.blocks.align import ROW_BIAS, align, most_norm
from zerodrift.blocks.fields import TYPES, FieldPlace, list_places, put, read
from zerodrift.blocks.gru import count_pairs, find_overflow
from zerodrift.blocks.proof import BlockField, prove_set
from zerodrift.export.integer_model import FORMAT, IntegerModel, canonical_json
from zerodrift.export.model_files import parse_model
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN
from zerodrift.operations.delay import IntegerDelay
from zerodrift.operations.dense import IntegerDense
from zerodrift.operations.drift import IntegerDrift
from zerodrift.operations.exp2 import EXPONENT_BITS, IntegerExp2
from zerodrift.operations.features import IntegerFeatures
from zerodrift.operations.gru import IntegerGruLayer
from zerodrift.operations.input import IntegerInput
from zerodrift.operations.intervals import Bound
from zerodrift.operations.lowpass import IntegerLowpass
from zerodrift.operations.lowpass_after import IntegerLowpassAfter
from zerodrift.operations.node import IntegerNode
from zerodrift.operations.play import IntegerPlay
from zerodrift.operations.sum import IntegerSum

FILE_NAME = "design.json"
PROGRAM = "program"
"""Folder of a fleet's one program, below that of the C."""
FORMAT_OF_FILE = 1
FORMAT_OF_BLOCK = 1
"""Of a block's layout; the chip refuses any other."""
MARGIN = 0.25
"""A number of a block may lie beyond what the units showed by this share of the largest of them."""
ROW_MARGIN = 3.0
"""The same of coefficients of 64-bit rows, where there is room."""
SHRINKS = 8
"""How often margins are halved before the units alone are taken."""
NORM_UNITS = 2**15
"""Largest int16 input of a row of 16-bit weights."""


@dataclass(frozen=True)
class BlockDesign:
    """What one program and all of its blocks have in common."""

    model: IntegerModel
    """Operations, names, shifts and sizes; the numbers of its fields are one unit's."""
    fields: tuple[BlockField, ...]
    """In the order in which they stand in a block."""

    @cached_property
    def identity(self) -> str:
        """SHA-256 of operations, format and set, 64 hexadecimal digits: what a block names."""
        empty = {f.place: np.zeros(f.place.sizes, dtype=np.int64) for f in self.fields}
        body = put(self.model, empty).to_json()
        body.pop("notes")
        said: dict[str, Json] = {
            "block": FORMAT_OF_BLOCK,
            "arithmetic": FORMAT,
            "model": body,
            "fields": to_json(self.fields),
        }
        return hashlib.sha256(canonical_json(said).encode()).hexdigest()

    @property
    def words(self) -> tuple[int, int]:
        """The first 64 bits of the identity, as two words of a block."""
        return int(self.identity[:8], 16), int(self.identity[8:16], 16)

    def prove(self) -> list[Bound]:
        """Return every bound, for any codes and any block of the set.

        Raises:
            CheckError: one does not hold.
        """
        return prove_set(self.model, self.fields)

    def fit(self, model: IntegerModel) -> IntegerModel:
        """Return a unit's model in this design's format.

        Raises:
            CheckError: the unit is of another design, or a number lies outside the set.
        """
        (aligned,) = align([model], self.model)
        aligned = self._hold_zero(aligned)
        for field in self.fields:
            why = find_outside(field, read(aligned, field.place))
            if why:
                raise CheckError(
                    f"the unit does not fit its design: {field.place.name}: {why}. Make a new"
                    " design from all units (delete design.json), which means a new program."
                )
        aligned.prove()
        return replace(aligned, notes={**aligned.notes, "design": self.identity})

    def _hold_zero(self, model: IntegerModel) -> IntegerModel:
        """Return a model whose limits of the answer leave room for those of the set."""
        low, high = self.answer_limits
        drift = model.drift
        return put(
            model,
            {
                low.place: np.minimum(np.array(drift.low), low.high),
                high.place: np.maximum(np.array(drift.high), high.low),
            },
        )

    @property
    def answer_limits(self) -> tuple[BlockField, BlockField]:
        """The fields that the answer is limited by, the lower first."""
        own = [f for f in self.fields if f.place.node == self.model.drift.name]
        low, high = (f for name in ("low", "high") for f in own if f.place.attribute == name)
        return low, high

    def to_text(self) -> str:
        """Return the design's file: canonical JSON with its identity."""
        body: dict[str, Json] = {
            "design": FORMAT_OF_FILE,
            "identity": self.identity,
            "model": {**self.model.to_json(), "hash": self.model.hash},
            "fields": to_json(self.fields),
        }
        return canonical_json(body) + "\n"


def find_outside(field: BlockField, numbers: IntArray) -> str:
    """Return why numbers are not within a field's part of the set; "" if they are."""
    low, high = int(numbers.min(initial=field.high)), int(numbers.max(initial=field.low))
    if low < field.low or high > field.high:
        return f"{low if low < field.low else high} is outside {field.low} .. {field.high}"
    if field.pairs:
        return find_overflow(numbers, (field.pairs[0], field.pairs[1]))
    if field.norm:
        norm = int(np.abs(numbers.reshape(-1, field.row)).sum(axis=1).max())
        if norm > field.norm:
            return f"a row's L1 norm of {norm} is above {field.norm}"
    return ""


def find_design(firmware: Path) -> Path | None:
    """Return the design's file in a firmware's folder, that of a unit or of a fleet, if any."""
    places = (firmware / FILE_NAME, firmware / PROGRAM / FILE_NAME)
    return next((place for place in places if place.is_file()), None)


def load_design(path: Path) -> BlockDesign:
    """Return a design from its file.

    Raises:
        InputError: it cannot be read, or its identity does not match.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        claims = from_json(_DesignFile, told, str(path))
        design = BlockDesign(parse_model(f"{path}: model", dict(told).get("model")), claims.fields)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: no design of zerodrift ({error}); expected what `firmware` or `fleet` wrote."
            " Take it from a backup: a new one is a new program."
        ) from error
    if claims.design != FORMAT_OF_FILE or claims.identity != design.identity:
        raise InputError(
            f"{path}: identity {claims.identity[:12]} does not belong to its content, or another"
            " version of zerodrift wrote it. Make the design again from all units."
        )
    return design


@dataclass(frozen=True)
class _DesignFile:
    """What a design's file holds beside the model."""

    design: int
    identity: str
    fields: tuple[BlockField, ...]


def make_design(models: Sequence[IntegerModel], margin: float = MARGIN) -> BlockDesign:
    """Return the design of some units: the finest format that all can have, and the widest set
    around them that is free of overflow.

    Args:
        models: of one unit or more.
        margin: how far beyond them a later unit's numbers may lie, as a share of the largest.

    Raises:
        CheckError: the units have no common format.
    """
    aligned = align(models, margin=margin)
    places = list_places(aligned)
    aligned = [_hold_middle(model, aligned) for model in aligned]
    order = sorted(places, key=lambda p: -np.dtype(TYPES[p.type]).itemsize)
    for attempt in range(SHRINKS + 1):
        share = margin / 2**attempt if attempt < SHRINKS else 0.0
        fields = tuple(_choose_set(aligned, place, share) for place in order)
        design = BlockDesign(aligned[0], fields)
        try:
            design.prove()
        except CheckError as error:
            refusal = error
        else:
            return design
    raise CheckError(f"these units have no common format that is free of overflow: {refusal}")


def _hold_middle(model: IntegerModel, units: Sequence[IntegerModel]) -> IntegerModel:
    """Return a unit's model with limits of the answer on either side of one number for all.

    They change only where one output's drift is always above what another's is always below; they
    then limit less than the unit's own do.
    """
    drifts = [unit.drift for unit in units]
    middle = _middle(max(max(d.low) for d in drifts), min(min(d.high) for d in drifts))
    drift = replace(
        model.drift,
        low=tuple(min(low, middle) for low in model.drift.low),
        high=tuple(max(high, middle) for high in model.drift.high),
    )
    return replace(model, nodes=(*model.nodes[:-1], drift))


def _choose_set(models: Sequence[IntegerModel], place: FieldPlace, share: float) -> BlockField:
    """Return what a field may be: what the units have and a margin, as far as its kind allows."""
    numbers = np.stack([read(model, place) for model in models])
    low, high = int(numbers.min(initial=0)), int(numbers.max(initial=0))
    if numbers.size:
        low, high = int(numbers.min()), int(numbers.max())
    node = next((n for n in models[0].nodes if n.name == place.node), None)
    if place.type == "u8":
        return BlockField(place, 0, 31 if isinstance(node, IntegerDense) else 63)
    if place.type == "i16":
        bias = ROW_BIAS if isinstance(node, IntegerDense) else 0
        row = numbers.shape[-1] // (node.width if node is not None else 1)
        return BlockField(place, -32767, 32767, most_norm(NORM_UNITS, bias), row)
    if isinstance(node, IntegerDelay):
        return BlockField(place, 0, INT32_MAX)
    if isinstance(node, IntegerGruLayer):
        return BlockField(place, INT32_MIN, INT32_MAX, pairs=count_pairs(node.gru))
    if isinstance(node, IntegerDense):
        return BlockField(place, -ROW_BIAS, ROW_BIAS)
    largest = max(abs(low), abs(high), 1)
    if _is_row(node) and place.attribute not in ("low", "high"):
        most = 2**61 if place.type == "i64" else INT32_MAX
        reach = min(round(largest * (1.0 + ROW_MARGIN * share / MARGIN)), most)
        return BlockField(place, -max(reach, largest), max(reach, largest))
    if place.attribute in LIMITS:
        return _choose_limit(models, place, low, high, share)
    spread = round(largest * share)
    bottom, top = _ends(node)
    if place.attribute == "rate_max" and models[0].variable_step:
        bottom = 0  # a rate is multiplied by a time there
    return BlockField(place, max(low - spread, bottom), min(high + spread, top))


LIMITS = {
    "low": "high",
    "high": "low",
    "temperature_low": "temperature_high",
    "temperature_high": "temperature_low",
    "range_low": "range_high",
    "range_high": "range_low",
}
"""Attributes that are ends of a range, and the other ends."""


def _is_row(node: IntegerNode | None) -> bool:
    return isinstance(node, IntegerSum | IntegerFeatures | IntegerDrift | IntegerExp2)


def _ends(node: IntegerNode | None) -> tuple[int, int]:
    if isinstance(node, IntegerLowpass | IntegerLowpassAfter):
        return 1, INT32_MAX
    if isinstance(node, IntegerPlay):
        return 0, INT32_MAX
    return INT32_MIN, INT32_MAX


def _choose_limit(
    models: Sequence[IntegerModel], place: FieldPlace, low: int, high: int, share: float
) -> BlockField:
    """Return what an end of a range may be: on its own side of a middle."""
    other = replace(place, attribute=LIMITS[place.attribute])
    ends = np.stack([read(model, other) for model in models])
    is_low = place.attribute.endswith("low")
    lows, highs = ((low, high), (int(ends.min()), int(ends.max())))[:: 1 if is_low else -1]
    middle = _middle(lows[1], highs[0])
    if lows[1] > highs[0]:
        raise CheckError(
            f"{place.name}: one unit's lower end ({lows[1]}) is above another's upper one"
            f" ({highs[0]}): they were calibrated in ranges that do not meet, and have no design"
            " in common. Calibrate them over a common range."
        )
    spread = round(share * max(highs[1] - lows[0], 1))
    bottom, top = _codes(models[0], place)
    if is_low:
        return BlockField(place, max(lows[0] - spread, bottom), min(lows[1] + spread, middle))
    return BlockField(place, max(highs[0] - spread, middle), min(highs[1] + spread, top))


def _middle(low: int, high: int) -> int:
    """Return a number between all lower and all upper ends: 0, if it is there."""
    return 0 if low <= 0 <= high else (low + high) // 2


def _codes(model: IntegerModel, place: FieldPlace) -> tuple[int, int]:
    node = next((n for n in model.nodes if n.name == place.node), None)
    if isinstance(node, IntegerInput):
        channel = model.channels[node.channel]
        return channel.least, channel.most
    if isinstance(node, IntegerExp2):
        return node.low, ((node.top + 1) << EXPONENT_BITS) - 1
    return INT32_MIN, INT32_MAX
