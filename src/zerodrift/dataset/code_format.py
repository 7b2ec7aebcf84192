"""Codes of one input of the chip, and the values that they can hold."""

from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.conversion_config import ConversionConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.checks import guess_temperature_unit
from zerodrift.dataset.raw_codes import RawCover, RawRange
from zerodrift.dataset.runs import Run

TEMPERATURE, MEASURED, CLOCK = "temperature_degC", "measured:", "clock"
"""Sources of codes: the thermometer, `measured:Fz` of an output, or an input; one is the clock."""
AS_LOGGED = "as logged"
"""Unit of an input that has none of its own."""


@dataclass(frozen=True)
class ChipCodes:
    """The codes of one input: value = offset + code * lsb; or raw codes that become such codes."""

    name: str
    """`temperature`, `measured_Fz`, or the input's name."""
    source: str
    """`temperature_degC`, `measured:Fz`, or the input's name."""
    column: str
    """The column of the logs."""
    unit: str
    bits: int
    lsb: float
    no_reading: int | None
    """The code that means that there is no reading; None: there is no such code."""
    remedy: str
    """What a user can change where a log leaves the range of these codes."""
    offset: float = 0.0
    cover: RawCover | None = None
    """The raw codes that the chip is given; None: it is given these codes."""
    by: ConversionConfig | None = None
    """From raw code to value."""
    held: RawRange | None = None
    """Raw codes that have a value, where a table converts them."""

    @property
    def codes(self) -> tuple[int, int]:
        """The lowest and highest code that is a reading."""
        low, high = -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        if self.cover is not None and self.cover.is_plain:
            low, high = self.cover.least, self.cover.most
        return low + (self.no_reading == low), high - (self.no_reading == high)

    def holds(self, low: float, high: float) -> bool:
        """Tell whether codes hold both values, with one to spare on either side."""
        lowest, highest = self.codes
        return lowest < self._round(low) and self._round(high) < highest

    def _round(self, value: float) -> int:
        return round((value - self.offset) / self.lsb)

    def find_outside(self, values: Array) -> int | None:
        """Return the first position of values [n] that no code represents; None: there is none."""
        if self.held is not None:
            low, high = sorted(self.held.values)
            beyond = ~((values >= low) & (values <= high))
            return int(beyond.argmax()) if beyond.any() else None
        codes = np.round((values - self.offset) / self.lsb)
        lowest, highest = self.codes
        outside = ~((codes >= lowest) & (codes <= highest)) | (codes == self.no_reading)
        return int(outside.argmax()) if outside.any() else None

    def explain(self, place: str, run: Run, value: float) -> InputError:
        """Return the error about a value of a run that no code represents."""
        held = hint = ""
        if self.source == TEMPERATURE:
            hint = guess_temperature_unit(self.column, run.temperature_degC)
        if self.held is None and self._round(value) == self.no_reading:
            held = f", and {self.no_reading} means no reading"
        return InputError(
            f"{place}: run '{run.name}': {self.column} is {self.show(value)}; {self.describe()}"
            f"{held}.{hint} {self.remedy}"
        )

    def describe(self) -> str:
        """Return in words what the codes hold."""
        if self.held is not None and self.cover is not None and self.by is not None:
            low, high = (self.show(value) for value in sorted(self.held.values))
            codes = f"{self.cover.begin} .. {self.cover.end} of {self.cover.raw}"
            if self.by.junction is not None:
                codes = f"{self.cover.raw}, whatever '{self.by.junction}' is"
            kind = self.by.kind or "scaled"
            return f"the raw codes of '{self.name}' ({codes}, {kind}) hold {low} to {high}"
        low, high = (self.show(code * self.lsb + self.offset) for code in self.codes)
        kind = f"int{self.bits}" if self.cover is None else self.cover.raw
        kind = f"{kind}, {self.show(self.lsb)} each"
        return f"the codes of '{self.name}' ({kind}) hold {low} to {high}"

    def show(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.10g}" if self.unit == AS_LOGGED else f"{value:.10g} {self.unit}"
