"""The fields of a model's state in C, and the words that a guard's checksum is taken over."""

from collections.abc import Iterator

from zerodrift.codegen.names import name_channels
from zerodrift.export.integer_model import IntegerModel
from zerodrift.operations.c_text import StateField

MOST_WRITTEN_OUT = 512
"""Numbers of a field up to which they stand in the checksum's lines one by one: up to 8 bytes of
flash and two instructions a word. Longer fields are summed up by the runtime's loops, which need a
quarter more for 32 bits and several times as much for rows of 16."""


def list_state(model: IntegerModel, *, of_block: bool = False) -> tuple[StateField, ...]:
    """Return the fields in their order in the struct.

    Args:
        model: the integer model.
        of_block: whether the state belongs to a block, which it then names.

    In a guarded state the wide ones come first. It has no gaps then but at its end, and its numbers
    of 16 bits begin at a whole word, so that a compiler loads two at once.
    """
    channels = name_channels(model)
    thermometer = model.guards.temperature_channel
    fields = [
        StateField(
            model.channels[thermometer].bits,
            "previous_temperature",
            comment="code of the step before",
        )
    ]
    if of_block:
        told = "CRC of the block that moves it on"
        fields.insert(0, StateField(32, "block", comment=told, unsigned=True))
    fields += [
        StateField(
            model.channels[k].bits, f"last_{channels[k]}", comment="for steps without a reading"
        )
        for k in model.held
    ]
    if model.variable_step:
        fields.append(StateField(64, "slept_us", comment="to add to the next step"))
    if model.tare:
        count = (len(model.outputs),)
        fields.append(StateField(32, "answered", count, "drift of the step before, from no tare"))
        fields.append(StateField(32, "tare", count, "drift that is taken off"))
        fields.append(StateField(32, "tared", comment="0: no answer yet; 1: answered; 2: tared"))
    if model.feeds_back:
        told = "of the step before: what was measured less this is the load"
        fields.append(StateField(32, "drift", (len(model.outputs),), told))
    for node in model.nodes:
        fields += node.list_state()
    return tuple(sorted(fields, key=lambda f: -f.bits) if model.guarded else fields)


def list_words(fields: tuple[StateField, ...]) -> Iterator[str]:
    """Yield statements in C that take every number of a state `s` into the sum `check` once."""
    halves: list[str] = []
    for field in fields:
        if len(field.elements) > MOST_WRITTEN_OUT:
            yield from _list_rows(field)
        elif field.bits == 64:
            yield f"check = zd_check_i64(check, s->{field.name});"
        elif field.bits == 32 and field.unsigned:
            yield f"check = zd_check_word(check, s->{field.name});"
        elif field.bits == 32:
            for element in field.elements:
                yield f"check = zd_check_number(check, s->{element});"
        else:
            halves += field.elements
    for low, high in zip(halves[::2], halves[1::2], strict=False):
        pair = f"(uint16_t)s->{low} | ((uint32_t)(uint16_t)s->{high} << 16)"
        yield f"check = zd_check_word(check, {pair});"
    if len(halves) % 2:
        yield f"check = zd_check_word(check, (uint16_t)s->{halves[-1]});"


def _list_rows(field: StateField) -> Iterator[str]:
    """Yield a loop of the runtime's over one long field."""
    *rows, length = field.sizes
    index = "[k]" if rows else ""
    line = f"check = zd_check_i{field.bits}(check, s->{field.name}{index}, {length}u);"
    if rows:
        yield f"for (uint32_t k = 0; k < {rows[0]}u; k++) {{"
        yield f"    {line}"
        yield "}"
    else:
        yield line
