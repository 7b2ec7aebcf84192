"""The words of one line of a protocol: quantities with units, ranges, and clear refusals."""

import re
from dataclasses import dataclass

from zerodrift.base.errors import InputError, nearest
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS

ABSOLUTE_ZERO = -273.15
HOTTEST_DEGC = 500.0
LONGEST_S = 2e6

#: Unit -> dimension and factor to the dimension's first unit.
DIMENSIONS: dict[str, tuple[str, float]] = {
    "s": ("time", 1.0),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "degC": ("temperature", 1.0),
    "K": ("difference", 1.0),
    "K/min": ("rate", 1.0 / 60.0),
    "K/s": ("rate", 1.0),
    "W": ("power", 1.0),
    "W/m2K": ("airflow", 1.0),
    "N": ("force", 1.0),
    "Nm": ("moment", 1.0),
    "V": ("voltage", 1.0),
    "%": ("share", 1.0),
    "lux": ("light", 1.0),
    "m/s2": ("acceleration", 1.0),
    "Hz": ("frequency", 1.0),
}


@dataclass(frozen=True)
class Quantity:
    """A number with its unit, or a range from which every run draws its own."""

    low: float
    high: float


class Words:
    """The words of one line, taken from left to right."""

    def __init__(self, where: str, line: int, words: list[str]) -> None:
        self.where, self.line, self.words = where, line, words
        self.word = words[0]
        self.rest = words[1:]

    def error(self, message: str) -> InputError:
        """Return the error about this line."""
        return InputError(f"{self.where}:{self.line}: {message}")

    def next_is(self, *candidates: str) -> bool:
        """Return whether the next word is one of these."""
        return bool(self.rest) and self.rest[0] in candidates

    def take(self, expected: str) -> str:
        """Take the next word; `expected` says in an error what it should have been."""
        if not self.rest:
            raise self.error(f"'{' '.join(self.words)}' ends too early; expected {expected}.")
        return self.rest.pop(0)

    def expect(self, word: str) -> None:
        """Take the next word, which has to be this one."""
        found = self.take(f"'{word}'")
        if found != word:
            raise self.error(f"found '{found}'; expected '{word}'.")

    def quantity(self, dimension: str, what: str) -> Quantity:
        """Take a number or range and its unit, in the dimension's first unit."""
        units = [unit for unit, (of, _) in DIMENSIONS.items() if of == dimension]
        shown = f"{what} as NUMBER or LOW..HIGH and {' or '.join(units)}"
        number = self.take(shown)
        match = re.fullmatch(r"(.+?)\.\.(.+)", number)
        parts = match.groups() if match else (number,)
        try:
            numbers = [float(part) for part in parts]
        except ValueError:
            raise self.error(f"'{number}' is no number; expected {shown}.") from None
        if not all(abs(value) < 1e12 for value in numbers):
            raise self.error(f"'{number}' is not finite; expected {shown}.")
        unit = self.take(f"the unit of {what}, {' or '.join(units)}")
        if unit not in units:
            raise self.error(
                f"{what} is '{number} {unit}'; expected {' or '.join(units)}"
                f"{nearest(unit, units) or '.'}"
            )
        low, high = (value * DIMENSIONS[unit][1] for value in (numbers[0], numbers[-1]))
        if low > high:
            raise self.error(f"{what} runs from {number.replace('..', ' down to ')}; swap the two.")
        return Quantity(low, high)

    def duration(self, what: str, shortest: float = 0.1) -> Quantity:
        """Take a time that passes, s."""
        found = self.quantity("time", what)
        if found.low < shortest or found.high > LONGEST_S:
            raise self.error(
                f"{what} is {show_quantity(found)} s; expected {shortest:g} to {LONGEST_S:g} s."
            )
        return found

    def temperature(self, what: str) -> Quantity:
        """Take a temperature above absolute zero, degC."""
        found = self.quantity("temperature", what)
        if found.low <= ABSOLUTE_ZERO:
            raise self.error(
                f"{what} is {show_quantity(found)} degC, below absolute zero; expected more than "
                f"{ABSOLUTE_ZERO} degC."
            )
        if found.high > HOTTEST_DEGC:
            raise self.error(
                f"{what} is {show_quantity(found)} degC; expected at most {HOTTEST_DEGC:g} degC."
            )
        return found

    def within(self, found: Quantity, low: float, high: float, what: str, unit: str) -> Quantity:
        """Return the quantity if it lies within its limits."""
        if found.low < low or found.high > high:
            raise self.error(
                f"{what} is {show_quantity(found)} {unit}; expected {low:g} to {high:g} {unit}."
            )
        return found

    def axis(self) -> str:
        """Take the name of an output."""
        found = self.take(f"an output ({', '.join(OUTPUTS)})")
        if found not in OUTPUTS:
            raise self.error(
                f"no output '{found}'{nearest(found, OUTPUTS) or '.'} "
                f"Expected one of {', '.join(OUTPUTS)}."
            )
        return found

    def load_of(self, axis: str) -> Quantity:
        """Take a load in the output's own unit."""
        unit = UNITS[OUTPUTS.index(axis)]
        return self.quantity("force" if unit == "N" else "moment", f"the load on {axis}")

    def finish(self) -> None:
        """Refuse words that are left over."""
        if self.rest:
            raise self.error(f"'{' '.join(self.rest)}' is left over; take it out.")


def show_quantity(found: Quantity) -> str:
    """Return a number, or both ends of a range, as a protocol writes them."""
    low, high = f"{found.low:g}", f"{found.high:g}"
    return low if low == high else f"{low}..{high}"
