"""The checksum of a guarded state: its C takes every number of the state in, as documented.

32 bits turned by one to the right before each word is added: identity and steps, then the fields in
the order of the struct, wide ones as two words, numbers of 16 bits two to a word at the end; fields
of more than 512 numbers where they stand.
"""

from collections.abc import Iterator, Sequence

from zerodrift_proof.equality.machine import TermMachine
from zerodrift_proof.equality.memory import AddressOf, Number
from zerodrift_proof.equality.specification import Specification
from zerodrift_proof.equality.state import IDENTITY, STEPS
from zerodrift_proof.equality.terms import Terms, Whole
from zerodrift_proof.equality.types import TYPES

LONG = 512


def prove_checksum(machine: TermMachine, meaning: Specification, prefix: str) -> str:
    """Return where the C's checksum is another; "" where it is not."""
    terms = machine.terms
    instance = machine.make_instance(f"{prefix}_state_t", "s")
    state: dict[str, list[Whole]] = {}
    for field in meaning.fields:
        low, high = TYPES[field.type]
        mark = f"unsound s->{field.name}"
        state[field.name] = [terms.symbol(f"{mark}[{k}]", low, high) for k in range(field.count)]
        instance.fields[field.name].cells = list(state[field.name])
    found = machine.call(f"{prefix}_sum_up", [AddressOf(instance)])
    check = terms.constant(0)
    for number, word in enumerate(_list_words(terms, meaning, state)):
        check = word if number == 0 else _add(terms, check, word)
    return "" if isinstance(found, Number) and found.term is check else "another sum"


def _add(terms: Terms, check: Whole, word: Whole) -> Whole:
    turned = terms.add(terms.shift(check, 1), terms.modulo(terms.scale(check, 1 << 31), 32))
    return terms.modulo(terms.add(turned, word), 32)


def _list_words(
    terms: Terms, meaning: Specification, state: dict[str, list[Whole]]
) -> Iterator[Whole]:
    yield terms.modulo(state[IDENTITY][0], 32)
    yield state[STEPS][0]
    halves: list[Whole] = []
    for field in meaning.fields[2:-1]:
        cells = state[field.name]
        if "64" in field.type:
            for cell in cells:
                bits = terms.modulo(cell, 64)
                yield terms.modulo(bits, 32)
                yield terms.shift(bits, 32)
        elif "32" in field.type:
            yield from (terms.modulo(cell, 32) for cell in cells)
        elif len(cells) > LONG:
            length = field.sizes[-1]
            for row in range(0, len(cells), length):
                yield from _pair(terms, cells[row : row + length])
        else:
            halves += cells
    yield from _pair(terms, halves)


def _pair(terms: Terms, cells: Sequence[Whole]) -> Iterator[Whole]:
    for k in range(0, len(cells), 2):
        low = terms.modulo(cells[k], 16)
        if k + 1 < len(cells):
            high = terms.modulo(cells[k + 1], 16)
            yield terms.add(low, terms.scale(high, 1 << 16))
        else:
            yield low
