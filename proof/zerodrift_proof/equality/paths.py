"""The ways through conditions that are not known, and the memory that each of them writes."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from zerodrift_proof.equality.memory import (
    AddressOf,
    Cell,
    CellBlock,
    Found,
    Holder,
    Number,
    Numbers,
    Spot,
    list_positions,
)
from zerodrift_proof.equality.terms import UndecidedError, Whole
from zerodrift_proof.equality.types import TYPES

MOST_PATHS = 64
MOST_STATEMENTS = 2_000_000
"""On one path: golden models need 60,000 at most, and a loop within a loop may have no end."""


@dataclass
class CPath:
    """One way through the conditions that were not known."""

    script: list[int]
    made: list[tuple[int, int]] = field(default_factory=list)
    assumed: dict[int, int] = field(default_factory=dict)
    """Number of a truth -> what it is taken to be here."""


class PathMachine(Numbers):
    """Goes every path, and keeps what each has written."""

    def __init__(self) -> None:
        """Begin with nothing known."""
        super().__init__()
        self.variables: dict[str, Holder] = {}
        self.path = CPath([])
        self.log: list[tuple[CellBlock, int, Cell]] = []
        """What was overwritten, the last one last."""
        self.depth = 0
        """Of calls."""
        self.statements = 0
        """That were run on this path."""

    # --- paths

    def explore(self, run: Callable[[], None]) -> Iterator[CPath]:
        """Go every way through something; yield after each."""
        script: list[int] = []
        for _ in range(MOST_PATHS):
            self.path, self.depth, self.log, self.variables = CPath(script), 0, [], {}
            self.statements = 0
            run()
            yield self.path
            made = self.path.made
            while made and made[-1][0] + 1 == made[-1][1]:
                made.pop()
            if not made:
                return
            script = [way for way, _ in made[:-1]] + [made[-1][0] + 1]
        raise UndecidedError(f"more than {MOST_PATHS} paths")

    def count_statement(self) -> None:
        """Count one more statement of this path.

        Raises:
            UndecidedError: they are more than the C of a model has.
        """
        self.statements += 1
        if self.statements > MOST_STATEMENTS:
            raise UndecidedError(f"more than {MOST_STATEMENTS} statements on one path")

    def fork(self, ways: int) -> int:
        """Return which way to go; all are gone, one after the other."""
        made = self.path.made
        way = self.path.script[len(made)] if len(made) < len(self.path.script) else 0
        made.append((way, ways))
        return way

    def decide(self, truth: Whole) -> Whole:
        """Return a truth as this path takes it."""
        if truth.exact is not None or not self.path.assumed:
            return truth
        assumed = self.path.assumed
        if truth.number in assumed:
            return self.terms.constant(assumed[truth.number])
        opposite = self.terms.negate(truth)
        if opposite.number in assumed:
            return self.terms.constant(1 - assumed[opposite.number])
        for one, sign in ((truth, 0), (opposite, 1)):
            if one.kind == "or":
                members = [self.decide(self.terms.atom(n)) for n in one.inner]
                found = self.terms.either(members)
                if found is not one:
                    found = self.decide(found) if found.exact is None else found
                    return self.terms.negate(found) if sign else found
        return truth

    def suppose(self, truth: Whole, value: int) -> None:
        """Take a truth to be 0 or 1 on this path."""
        self.path.assumed[truth.number] = value
        if truth.kind == "or" and value == 0:
            for number in truth.inner:
                self.suppose(self.terms.atom(number), 0)
        opposite = self.terms.negate(truth)
        if opposite.kind == "or" and value == 1:
            self.suppose(opposite, 0)

    # --- memory

    def write(self, block: CellBlock, at: int, cell: Cell) -> None:
        """Write a cell."""
        if block.constant:
            raise UndecidedError(f"{block.name} is constant, and is written")
        self.log.append((block, at, block.cells[at]))
        block.cells[at] = cell

    def load(self, place: Spot) -> Found:
        """Return what a cell holds."""
        cells = place.block.cells
        at = place.at.exact
        if at is not None:
            if not 0 <= at < len(cells):
                raise UndecidedError(f"element {at} of {place.block.name}, which has {len(cells)}")
            return self.as_found(place.block, cells[at])
        found: dict[int, Whole] = {}
        for n in list_positions(place.at, self.terms, len(cells)):
            cell = cells[n]
            if not isinstance(cell, Whole):
                raise UndecidedError(f"{place.block.name} is read before it is written")
            found[n] = cell
        return Number(self.terms.select(place.at, found), place.block.type)

    def as_found(self, block: CellBlock, cell: Cell) -> Found:
        """Return what a cell of a block holds, as a value of the C."""
        if cell is None:
            raise UndecidedError(f"{block.name} is read before it is written")
        if isinstance(cell, Whole) and block.type == "pointer":  # to nothing
            return Number(cell, "int32_t")
        return Number(cell, block.type) if isinstance(cell, Whole) else cell

    def store(self, place: Spot, value: Found) -> None:
        """Write a cell, wherever it may be."""
        block = place.block
        if isinstance(value, Spot | AddressOf):
            cell: Cell = value
        elif isinstance(value, Number) and block.type in TYPES:
            cell = self.convert(value, block.type).term
        else:
            raise UndecidedError(f"{block.name} is given something else")
        at = place.at.exact
        if at is not None:
            if not 0 <= at < len(block.cells):
                raise UndecidedError(f"element {at} of {block.name}, which has {len(block.cells)}")
            self.write(block, at, cell)
            return
        for n in list_positions(place.at, self.terms, len(block.cells)):
            here, before = self.terms.equal(place.at, self.terms.constant(n)), block.cells[n]
            if not isinstance(before, Whole) or not isinstance(cell, Whole):
                raise UndecidedError(f"{block.name} is written in part")
            self.write(block, n, self.terms.choose(here, cell, before))

    def cells(self, place: Spot, count: int) -> list[Whole]:
        """Return the numbers from a place on."""
        first, found = place.at.exact, []
        for k in range(count):
            at = self.terms.add(place.at, self.terms.constant(k))
            value = self.load(Spot(place.block, at, ())) if first is None else None
            if first is not None:
                if first + k >= len(place.block.cells) or first < 0:
                    raise UndecidedError(f"{count} elements of {place.block.name} from {first} on")
                value = self.as_found(place.block, place.block.cells[first + k])
            if not isinstance(value, Number):
                raise UndecidedError(f"{place.block.name} is no row of numbers")
            found.append(value.term)
        return found
