"""Protocols: small text files that say what is done to the sensor, one statement a line.

The grammar is in docs/reference/six-axis-twin.md. Reading checks everything that can be checked
without a sensor, and every message names file and line.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

from zerodrift.base.errors import InputError, nearest
from zerodrift_lab.twin.six_axis.words import LONGEST_S, Quantity, Words

MOST_REPEATS = 1000


@dataclass(frozen=True)
class Statement:
    """One line of a protocol."""

    line: int
    word: str
    text: str = ""
    """For words that take one: `on`, `none`, an axis."""
    values: Mapping[str, Quantity] = field(default_factory=dict)
    body: tuple["Statement", ...] = ()
    """What `repeat` repeats."""


@dataclass(frozen=True)
class Protocol:
    """What is done to the sensor in one run."""

    name: str
    """The file's stem, and the first part of the runs' names."""
    title: str
    where: str
    """How messages name the file."""
    statements: tuple[Statement, ...]


def _over(words: Words, default: float) -> Quantity:
    if words.next_is("over"):
        words.expect("over")
        return words.duration("the time of the change")
    return Quantity(default, default)


def _read_air(words: Words) -> Statement:
    values = {"to": words.temperature("the air's temperature")}
    if words.next_is("at"):
        words.expect("at")
        rate = words.quantity("rate", "the rate of the air")
        if rate.low <= 0.0:
            raise words.error(
                f"the rate of the air is {60.0 * rate.low:g} K/min; expected more than "
                "0: the target says whether it rises or falls."
            )
        values["rate"] = rate
    else:
        values["over"] = _over(words, 10.0)
    if words.next_is("then"):
        words.expect("then")
        words.expect("wait")
        values["then_wait"] = words.duration("the wait")
    return Statement(words.line, "air", values=values)


def _read_plate(words: Words) -> Statement:
    if words.next_is("none"):
        words.expect("none")
        return Statement(words.line, "plate", "none")
    ahead = words.rest[1:2]
    if ahead == ["K"]:
        rise = words.quantity("difference", "the change of the thermometer")
        words.expect("in")
        return Statement(
            words.line,
            "plate",
            "rise",
            {"rise": rise, "in": words.duration("the time of the change", 5.0)},
        )
    to = words.temperature("the plate's temperature")
    return Statement(words.line, "plate", "hold", {"to": to, "over": _over(words, 6.0)})


def _read_lamp(words: Words) -> Statement:
    if words.next_is("off"):
        words.expect("off")
        return Statement(words.line, "lamp", "hold", {"to": Quantity(0, 0), "over": Quantity(2, 2)})
    if words.rest[1:2] == ["K"]:
        rise = words.quantity("difference", "the rise of the thermometer")
        words.within(rise, 0.0, 500.0, "the rise of the thermometer", "K")
        words.expect("in")
        return Statement(
            words.line,
            "lamp",
            "rise",
            {"rise": rise, "in": words.duration("the time of the rise", 5.0)},
        )
    power = words.quantity("power", "the lamp's power on the sensor")
    words.within(power, 0.0, 100.0, "the lamp's power on the sensor", "W")
    return Statement(words.line, "lamp", "hold", {"to": power, "over": _over(words, 2.0)})


def _read_level(
    dimension: str, unit: str, low: float, high: float, what: str, over_s: float
) -> Callable[[Words], Statement]:
    def read(words: Words) -> Statement:
        to = words.within(words.quantity(dimension, what), low, high, what, unit)
        return Statement(words.line, words.word, values={"to": to, "over": _over(words, over_s)})

    return read


def _read_load(words: Words) -> Statement:
    if words.next_is("none"):
        words.expect("none")
        return Statement(words.line, "load", "none", {"over": _over(words, 3.0)})
    axis = words.axis()
    to = words.load_of(axis)
    return Statement(words.line, "load", axis, {"to": to, "over": _over(words, 3.0)})


def _read_gait(words: Words) -> Statement:
    if words.next_is("off"):
        words.expect("off")
        return Statement(words.line, "gait", "off")
    values = {"stride": words.duration("the stride", 0.1)}
    values["duty"] = Quantity(60.0, 60.0)
    if words.next_is("duty"):
        words.expect("duty")
        duty = words.quantity("share", "the share of the stride on the ground")
        values["duty"] = words.within(
            duty, 5.0, 100.0, "the share of the stride on the ground", "%"
        )
    while words.rest:
        axis = words.axis()
        if axis in values:
            raise words.error(f"{axis} is named twice; name it once.")
        values[axis] = words.load_of(axis)
    if len(values) == 2:
        raise words.error("a gait without load; expected an output and its peak, such as Fz 120 N.")
    return Statement(words.line, "gait", "on", values)


def _read_shake(words: Words) -> Statement:
    what = "the acceleration"
    peak = words.within(words.quantity("acceleration", what), 0.0, 500.0, what, "m/s2")
    words.expect("at")
    often = words.within(
        words.quantity("frequency", "the frequency"), 0.01, 50.0, "the frequency", "Hz"
    )
    words.expect("for")
    return Statement(
        words.line,
        "shake",
        values={"peak": peak, "often": often, "for": words.duration("the shaking", 1.0)},
    )


def _read_choice(*known: str) -> Callable[[Words], Statement]:
    def read(words: Words) -> Statement:
        found = words.take(" or ".join(known))
        if found not in known:
            raise words.error(
                f"{words.word} is '{found}'{nearest(found, known) or '.'} "
                f"Expected {' or '.join(known)}."
            )
        return Statement(words.line, words.word, found)

    return read


def _read_wait(words: Words) -> Statement:
    return Statement(words.line, "wait", values={"for": words.duration("the wait")})


def _read_room(words: Words) -> Statement:
    return Statement(words.line, "room", values={"to": words.temperature("the room's temperature")})


#: Word -> how the rest of its line is read. `title`, `repeat` and `end` stand apart.
READERS: dict[str, Callable[[Words], Statement]] = {
    "room": _read_room,
    "power": _read_choice("on", "before"),
    "reference": _read_choice("weights", "capacitive"),
    "wait": _read_wait,
    "air": _read_air,
    "airflow": _read_level("airflow", "W/m2K", 1.0, 200.0, "the airflow", 0.1),
    "plate": _read_plate,
    "lamp": _read_lamp,
    "load": _read_load,
    "gait": _read_gait,
    "supply": _read_level("voltage", "V", 0.0, 60.0, "the supply", 2.0),
    "humidity": _read_level("share", "%", 0.0, 100.0, "the humidity", 90.0),
    "light": _read_level("light", "lux", 0.0, 2e5, "the light", 1.5),
    "shake": _read_shake,
}
AT_START = ("room", "power", "reference")
WORDS = ("title", *READERS, "repeat", "end")


def _read_block(
    where: str, lines: Iterator[tuple[int, list[str]]], opened: int | None
) -> tuple[Statement, ...]:
    """Read statements up to the `end` of the block opened on that line, or to the file's end."""
    found: list[Statement] = []
    for line, words in lines:
        taken = Words(where, line, words)
        if taken.word == "end":
            if opened is None:
                raise taken.error("'end' without 'repeat'; take it out.")
            taken.finish()
            return tuple(found)
        if taken.word == "repeat":
            count = taken.take("how many times")
            if not count.isdigit() or not 1 <= int(count) <= MOST_REPEATS:
                raise taken.error(
                    f"repeat {count}; expected a whole number from 1 to {MOST_REPEATS}."
                )
            taken.finish()
            times = float(count)
            body = _read_block(where, lines, line)
            if not body:
                raise taken.error("nothing between 'repeat' and 'end'; expected statements.")
            found.append(
                Statement(line, "repeat", values={"times": Quantity(times, times)}, body=body)
            )
            continue
        if taken.word not in READERS:
            raise taken.error(
                f"unknown word '{taken.word}'{nearest(taken.word, WORDS) or '.'} "
                f"Expected one of {', '.join(WORDS)}."
            )
        statement = READERS[taken.word](taken)
        taken.finish()
        if taken.word in AT_START and (opened is not None or _moved(found)):
            raise taken.error(f"'{taken.word}' stands after other statements; move it to the top.")
        found.append(statement)
    if opened is not None:
        raise InputError(f"{where}:{opened}: 'repeat' has no 'end'; add one.")
    return tuple(found)


def _moved(found: list[Statement]) -> bool:
    return any(statement.word not in AT_START for statement in found)


def _measure(statements: tuple[Statement, ...]) -> float:
    """Return the longest that the statements can last, s; an upper bound."""
    total = 0.0
    for statement in statements:
        if statement.word == "repeat":
            total += statement.values["times"].high * _measure(statement.body)
        elif statement.word == "wait":
            total += statement.values["for"].high
        elif "then_wait" in statement.values:
            total += statement.values["then_wait"].high
            if "over" in statement.values:
                total += statement.values["over"].high
            else:
                total += 800.0 / statement.values["rate"].low
    return total


def parse_protocol(text: str, where: str, name: str) -> Protocol:
    """Return the protocol in a text; `where` names the file in messages.

    Raises:
        InputError: what is wrong, with file and line.
    """
    title = ""
    lines: list[tuple[int, list[str]]] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        words = raw.partition("#")[0].split()
        if not words:
            continue
        if words[0] == "title":
            if title or lines:
                raise InputError(f"{where}:{number}: the title stands first, once; move it.")
            title = " ".join(words[1:])
            continue
        lines.append((number, words))
    statements = _read_block(where, iter(lines), None)
    lasts_s = _measure(statements)
    if lasts_s <= 0.0:
        raise InputError(
            f"{where}: the protocol takes no time; expected a 'wait' such as: wait 10 min"
        )
    if lasts_s > LONGEST_S:
        raise InputError(
            f"{where}: the protocol lasts up to {lasts_s:.3g} s; expected at most {LONGEST_S:g} s."
        )
    return Protocol(name, title or name, where, statements)


def list_protocols() -> tuple[str, ...]:
    """Return the names of the bundled protocols."""
    folder = resources.files("zerodrift_lab.twin.six_axis") / "protocols"
    return tuple(
        sorted(p.name.removesuffix(".txt") for p in folder.iterdir() if p.name.endswith(".txt"))
    )


def load_protocol(source: str | Path) -> Protocol:
    """Return a bundled protocol by its name, or one from a file.

    Raises:
        InputError: there is no such protocol, or it is wrong, with file and line.
    """
    bundled = list_protocols()
    if str(source) in bundled:
        folder = resources.files("zerodrift_lab.twin.six_axis") / "protocols"
        text = (folder / f"{source}.txt").read_text(encoding="utf-8")
        return parse_protocol(text, f"{source}.txt", str(source))
    path = Path(source)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(
            f"{source}: neither a file nor a bundled protocol{nearest(str(source), bundled) or '.'}"
            f" Bundled: {', '.join(bundled)}."
        ) from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the path.") from None
    except UnicodeDecodeError:
        raise InputError(
            f"{path}: is not UTF-8 text; expected a protocol, saved as UTF-8."
        ) from None
    name = re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem).strip("_") or "protocol"
    return parse_protocol(text, str(path), name)
