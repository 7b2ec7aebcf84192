"""What is changed: one operator per class of mutants, each drawing one edit of one file."""

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

from benchmarks.mutants.source import Source

_TYPE = r"(?:u?int(?:8|16|32|64)_t|unsigned)"
_TYPES = tuple(f"{sign}int{bits}_t" for sign in ("", "u") for bits in (8, 16, 32, 64))
_TABLE = re.compile(rf"const ({_TYPE}) \w+((?:\[[^\]]*\])+)")
_FILLED = re.compile(rf"const (?:{_TYPE}|\w+_t) \w+(?:\[[^\]]*\])* = \{{([^;]*)\}};")
_CALL = re.compile(r"\b(zd_\w+|gru\w*_step\w*|\w+_(?:rest|relax|advance|init))\(")
_COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
_MNEMONICS = {
    **{"adds": "subs", "subs": "adds", "add": "sub", "ldrsh": "ldrh", "asrs": "lsrs"},
    **{"lsls": "asrs", "ands": "orrs", "sxth": "uxth", "bne": "beq", "beq": "bne"},
    **{"smlad": "smladx", "smlabb": "smlabt", "smlatb": "smlabb", "ssat": "usat"},
    **{"muls": "adds", "ldm": "stm", "stm": "ldm", "ldrd": "strd", "smmlar": "smmla"},
}


@dataclass(frozen=True)
class Edit:
    """Characters start to end of a file give way to a text."""

    start: int
    end: int
    text: str


Operator = Callable[[Source, random.Random], Edit | None]


def change_table_type(source: Source, rng: random.Random) -> Edit | None:
    """Declare a constant table with another type."""
    found = [m for m in _TABLE.finditer(source.code) if not source.is_directive(m.start())]
    return _retype(found, 1, rng)


def change_table_size(source: Source, rng: random.Random) -> Edit | None:
    """Declare a constant table with another number of entries."""
    tables = [m for m in _TABLE.finditer(source.code) if not source.is_directive(m.start())]
    found = [
        n for m in tables for n in re.compile(r"\[([^\]]+)\]").finditer(source.code, *m.span(2))
    ]
    return _resize(found, rng)


def change_table_entry(source: Source, rng: random.Random) -> Edit | None:
    """Change a number of a constant table by one, by a bit, in its sign or its base."""
    tables = list(_FILLED.finditer(source.code))
    if not tables:
        return None
    chosen = rng.choice(tables)
    numbers = re.compile(r"(?<!\w)-?\d+").finditer(source.code, *chosen.span(1))
    return _edit_number(list(numbers), rng)


def change_local_type(source: Source, rng: random.Random) -> Edit | None:
    """Declare a local variable, array or parameter, or a field of a struct, with another type."""
    found = source.find_in_functions(rf"\b({_TYPE})(?= \*?\w+(?:\[[^\]]*\])*(?:;| =))")
    for struct in re.finditer(r"typedef struct \{(.*?)\}", source.code, re.DOTALL):
        found += re.compile(rf"\b({_TYPE})(?= \*?\w+(?:\[[^\]]*\])*;)").finditer(
            source.code, *struct.span(1)
        )
    found += re.finditer(rf"\b({_TYPE})(?= \*?\w+(?:\[[^\]]*\])?[,)])", source.code)
    return _retype([m for m in found if not source.is_directive(m.start())], 1, rng)


def change_local_size(source: Source, rng: random.Random) -> Edit | None:
    """Declare a local array, or an array of the state, with another size."""
    found = re.finditer(rf"(?m)^\s+(?:{_TYPE}) \w+\[([^\]]+)\](?:\[\w+\])?(?:;| =)", source.code)
    return _resize(list(found), rng)


def change_argument(source: Source, rng: random.Random) -> Edit | None:
    """Give a kernel another argument: a number beside it, none, its neighbour, another table."""
    calls = source.find_in_functions(_CALL.pattern)
    if not calls:
        return None
    spans = _split_arguments(source.code, rng.choice(calls).end())
    if not spans:
        return None
    start, end = rng.choice(spans)
    old = source.code[start:end].strip()
    start += len(source.code[start:end]) - len(source.code[start:end].lstrip())
    number = re.fullmatch(r"-?\d+(u?)", old)
    others = [source.code[a:b].strip() for a, b in spans]
    tables = sorted({m[1] for m in re.finditer(r"const \w+ (\w+)\[", source.code)})
    options = ["0", "-1", "1", f"({old}) + 1", f"({old}) - 1", rng.choice(others)]
    if number:
        options += _vary(old.rstrip("u"), number[1], rng)
    if tables and ("&" in old or old in tables):
        options += 4 * [rng.choice(tables), f"&{rng.choice(tables)}[1]"]
    return Edit(start, start + len(old), rng.choice(options))


def change_literal(source: Source, rng: random.Random) -> Edit | None:
    """Change a number in a function: by one, a bit, the sign, to octal, to one without suffix."""
    found = source.find_in_functions(r"(?<![\w.\"])\d+u?\b")
    if not found:
        return None
    match = rng.choice(found)
    digits = match[0].rstrip("u")
    return Edit(match.start(), match.end(), rng.choice(_vary(digits, match[0][len(digits) :], rng)))


def change_loop(source: Source, rng: random.Random) -> Edit | None:
    """Change where a loop begins or ends, or how it goes on."""
    found = source.find_in_functions(r"\bfor \(([^;()]*);([^;]*);([^;{]*)\) \{")
    found += source.find_in_functions(r"\bwhile \(()(.*?)()\) \{")
    if not found:
        return None
    match = rng.choice(found)
    condition = match[2]
    bound = re.search(r"(<=|<|>|!=) ([^=].*)$", condition.strip())
    at = match.start(2)
    options = [Edit(at, match.end(2), " 1"), Edit(at, match.end(2), " 0")]
    if bound:
        left = condition.strip()[: bound.start()]
        for new in (
            *(f"{left}<= {bound[2]}", f"{left}{bound[1]} ({bound[2]}) + 1u"),
            *(f"{left}{bound[1]} ({bound[2]}) - 1u", f"{left}{bound[1]} 4294967295u"),
            *(
                f"{left}{bound[1]} 010u",
                f"{left}!= {bound[2]}",
                f"{left}{bound[1]} 2u * ({bound[2]})",
            ),
        ):
            options += 2 * [Edit(at, match.end(2), f" {new}")]
    if match[1]:
        options.append(Edit(match.start(1), match.end(1), match[1].replace("= 0", "= 1")))
    if "++" in match[3]:
        options.append(Edit(match.start(3), match.end(3), match[3].replace("++", " += 2u")))
    return rng.choice(options)


def change_statement(source: Source, rng: random.Random) -> Edit | None:
    """Leave out a statement, do it twice, or do it after the next."""
    functions = [(s, _list_statements(source, s.start, s.end)) for s in source.functions]
    functions = [(span, found) for span, found in functions if found]
    if not functions:
        return None
    _, found = rng.choice(functions)
    number = rng.randrange(len(found))
    start, end = found[number]
    way = rng.choice(("drop", "drop", "twice", "swap"))
    text = source.text[start:end]
    if (
        way == "swap"
        and number + 1 < len(found)
        and not source.code[end : found[number + 1][0]].strip()
    ):
        after, last = found[number + 1]
        return Edit(start, last, source.text[after:last] + source.text[end:after] + text)
    return Edit(start, end, f"{text} {text}" if way == "twice" else ";")


def change_guard(source: Source, rng: random.Random) -> Edit | None:
    """Ask whether the state is sound and do nothing with the answer, or the opposite."""
    found = source.find_in_functions(
        r"\w*is_sound\([^()]*\)(?: [!=]= \w+)?|\|\||sound = 0u|refused = 1u"
        r"|refused != 0u|return sound"
    )
    if not found:
        return None
    match = rng.choice(found)
    old = match[0]
    options = {
        "||": ["&&", "|"],
        "sound = 0u": ["sound = 1u", "(void)sound"],
        "refused = 1u": ["refused = 0u", "(void)refused"],
        "refused != 0u": ["refused == 0u", "refused > 1u"],
        "return sound": ["return 1u", "return sound == 0u"],
    }.get(
        old, ["(1 == 0)", "(1 == 1)", re.sub("== 0u", "!= 0u", old), re.sub("== 0u", "== 2u", old)]
    )
    if "is_sound" in old and "==" not in old:
        options = ["1u", "0u"]
    return Edit(match.start(), match.end(), rng.choice(options))


def change_clamp(source: Source, rng: random.Random) -> Edit | None:
    """Take a limit away, or move one of its ends."""
    found = source.find_in_functions(r"\bzd_(?:clamp32|clamp64|saturate20|read_q30)\(")
    found += source.find_in_functions(r"\(x (?:<|>) \w+\) \? \w+ :")
    if not found:
        return None
    match = rng.choice(found)
    if "?" in match[0]:
        return Edit(match.start(), match.end(), "")
    spans = _split_arguments(source.code, match.end())
    if not spans:
        return None
    close = spans[-1][1] + 1
    first = source.code[slice(*spans[0])]
    options = 3 * [Edit(match.start(), close, f"({first})")]
    for low, high in spans[1:]:
        old = source.code[low:high].strip()
        start = high - len(source.code[low:high].lstrip())
        for new in (
            f"({old} + 1)",
            f"({old} - 1)",
            f"(-{old})",
            f"({old} * 16)",
            "INT32_MAX",
            "INT32_MIN",
        ):
            options.append(Edit(start, start + len(old), new))
    return rng.choice(options)


def change_shift(source: Source, rng: random.Random) -> Edit | None:
    """Shift by another amount, or the other way."""
    found = source.find_in_functions(r"(?:<<|>>)=? ?(\w+)?")
    found += source.find_in_functions(r"(?<=, )(\d+)u?(?=\))|(?<=\[)(?:\d)(?=\])")
    tables = re.finditer(r"shift\w*\[\d+\] = \{([^}]*)\}|\{(\d+(?:, \d+)+)\}", source.code)
    numbers = [n for m in tables for n in re.compile(r"\d+").finditer(source.code, *m.span())]
    if numbers and rng.random() < 0.4:
        return _edit_number(numbers, rng)
    if not found:
        return None
    match = rng.choice(found)
    number = re.search(r"\d+", match[0])
    if match[0][:2] in ("<<", ">>") and (number is None or rng.random() < 0.3):
        other = ">>" if match[0][0] == "<" else "<<"
        return Edit(match.start(), match.start() + 2, other)
    if number is None:
        return None
    start = match.start() + number.start()
    value = int(number[0])
    new = rng.choice([value + 1, max(value - 1, 0), 0, 31, 32, 63, 64, 2 * value])
    return Edit(start, start + len(number[0]), str(new))


def change_comparison(source: Source, rng: random.Random) -> Edit | None:
    """Compare in another way."""
    found = source.find_in_functions(r"(?<= )(<=|>=|==|!=|<|>)(?= )")
    if not found:
        return None
    match = rng.choice(found)
    return Edit(match.start(), match.end(), rng.choice([c for c in _COMPARISONS if c != match[0]]))


def change_operation(source: Source, rng: random.Random) -> Edit | None:
    """Compute another thing of the same numbers."""
    found = source.find_in_functions(
        r"(?<=[\w)\]] )(\+=|-=|\+|-|\*|&|\||\^)(?= )|\+\+|(?<=[ (])-(?=[a-z(])"
    )
    if not found:
        return None
    match = rng.choice(found)
    options = {"+=": ["-=", "="], "-=": ["+="], "++": ["--", ""], "-": ["+", ""]}
    new = options.get(match[0], [c for c in ("+", "-", "*", "&", "|", "^") if c != match[0]])
    return Edit(match.start(), match.end(), rng.choice(new))


def change_cast(source: Source, rng: random.Random) -> Edit | None:
    """Leave a cast out, or cast to another type."""
    found = source.find_in_functions(rf"\(({_TYPE})\)")
    if not found:
        return None
    match = rng.choice(found)
    new = "" if rng.random() < 0.5 else f"({rng.choice([t for t in _TYPES if t != match[1]])})"
    return Edit(match.start(), match.end(), new)


def change_assembly(source: Source, rng: random.Random) -> Edit | None:
    """Change an instruction: its number, its register, what it does; or leave it out."""
    found = list(re.finditer(r'(?m)^\s*"((?!\.|\d+:)[a-z]+[^"\n]*)\\n"', source.commentless))
    if not found:
        return None
    match = rng.choice(found)
    line = match[1]
    options = [""]
    for number in re.finditer(r"#(-?\d+)", line):
        value = int(number[1])
        before, after = line[: number.start(1)], line[number.end(1) :]
        others = (value + 1, value - 1, -value, value + 4, 2 * value)
        options += [f"{before}{new}{after}" for new in others]
    for register in re.finditer(r"\br(\d+)\b", line):
        new = (int(register[1]) + rng.choice((1, 2, 7))) % 13
        options += 2 * [f"{line[: register.start(1)]}{new}{line[register.end(1) :]}"]
    word = line.split()[0]
    if word in _MNEMONICS:
        options += 3 * [line.replace(word, _MNEMONICS[word], 1)]
    return Edit(match.start(1), match.end(1), rng.choice(options))


def change_directive(source: Source, rng: random.Random) -> Edit | None:
    """Take another arm of an #if, or define another number."""
    found = [
        match
        for match in re.finditer(r"(?m)^#(?:if|elif|ifdef|ifndef|define)\b.*$", source.commentless)
        if not re.search(r"_H$|_H\b\s*$", match[0])
    ]
    if not found:
        return None
    match = rng.choice(found)
    line = match[0]
    options = []
    for part in re.finditer(r"(?<![\w.])(\d+)(?=u?\b)", line):
        before, after = line[: part.start()], line[part.end() :]
        options += [f"{before}{new}{after}" for new in _vary(part[1], "", rng)]
    for old, new in (
        *((" == ", " != "), (" && ", " || "), (" || ", " && "), ("!defined", "defined")),
        *((" defined", " !defined"), ("#ifdef", "#ifndef"), ("#ifndef", "#ifdef"), (" + ", " - ")),
    ):
        if old in line:
            options.append(line.replace(old, new, 1))
    return Edit(match.start(), match.end(), rng.choice(options)) if options else None


def change_header(source: Source, rng: random.Random) -> Edit | None:
    """Tell the caller another unit, period, index, flag or order."""
    if source.name.startswith("zd_") or not source.name.endswith(".h"):
        return None
    options = []
    for match in re.finditer(r"(?m)^#define \w+ .*?(-?\d+)", source.commentless):
        options += [Edit(*match.span(1), new) for new in (*_vary(match[1], "", rng), "7")]
    for struct in re.finditer(r"typedef struct \{\n(.*?)\n\}", source.text, re.DOTALL):
        lines = list(re.compile(r"(?m)^ .*$").finditer(source.text, *struct.span(1)))
        for one, other in pairwise(lines):
            options += 3 * [Edit(one.start(), other.end(), f"{other[0]}\n{one[0]}")]
    return rng.choice(options) if options else None


OPERATORS: dict[str, tuple[Operator, int]] = {
    "table type": (change_table_type, 5),
    "table size": (change_table_size, 5),
    "table entry": (change_table_entry, 8),
    "type": (change_local_type, 10),
    "array size": (change_local_size, 6),
    "argument": (change_argument, 12),
    "literal": (change_literal, 8),
    "loop": (change_loop, 7),
    "statement": (change_statement, 8),
    "guard": (change_guard, 4),
    "clamp": (change_clamp, 6),
    "shift": (change_shift, 6),
    "comparison": (change_comparison, 4),
    "operation": (change_operation, 5),
    "cast": (change_cast, 6),
    "assembly": (change_assembly, 6),
    "#if and #define": (change_directive, 5),
    "header": (change_header, 4),
}
"""Class -> its operator, and how often it is drawn."""


def _vary(digits: str, suffix: str, rng: random.Random) -> list[str]:
    """Return numbers that somebody might write in place of one."""
    value = int(digits)
    bit = 1 << rng.randrange(max(value.bit_length(), 1))
    options = [str(n) + suffix for n in (value + 1, value - 1, value ^ bit, -value, 2 * value + 1)]
    if value >= 8:
        options += [f"0{value}{suffix}"] if re.fullmatch("[0-7]+", digits) else []
        options += [f"0{value:o}{suffix}", f"{value:o}{suffix}"]
    if suffix:
        options += [digits, f"4294967295{suffix}"]
    return [option for option in options if option != digits + suffix] or [str(value + 1)]


def _edit_number(found: list[re.Match[str]], rng: random.Random) -> Edit | None:
    if not found:
        return None
    match = rng.choice(found)
    return Edit(match.start(), match.end(), rng.choice(_vary(match[0], "", rng)))


def _retype(found: list[re.Match[str]], group: int, rng: random.Random) -> Edit | None:
    if not found:
        return None
    match = rng.choice(found)
    return Edit(*match.span(group), rng.choice([t for t in _TYPES if t != match[group]]))


def _resize(found: list[re.Match[str]], rng: random.Random) -> Edit | None:
    if not found:
        return None
    match = rng.choice(found)
    old = match[1]
    options = [f"({old}) + 1", f"({old}) - 1", f"2 * ({old})", f"({old}) / 2", "1", "700"]
    return Edit(*match.span(1), rng.choice(options))


def _split_arguments(code: str, at: int) -> list[tuple[int, int]]:
    """Return where the arguments of a call lie, whose opening parenthesis is before `at`."""
    spans, depth, start = [], 1, at
    for place in range(at, len(code)):
        letter = code[place]
        depth += {"(": 1, "[": 1, "{": 1, ")": -1, "]": -1, "}": -1}.get(letter, 0)
        if depth == 0 or (depth == 1 and letter == ","):
            if code[start:place].strip():
                spans.append((start, place))
            start = place + 1
        if depth == 0:
            break
    return spans


def _list_statements(source: Source, start: int, end: int) -> list[tuple[int, int]]:
    """Return where the statements of a function lie that declare nothing."""
    found = []
    pattern = re.compile(r"(?<=[;{}\n])[ \t]*([a-z*][^;{}#]*;)")
    for match in pattern.finditer(source.code, start, end):
        if not re.match(rf"(?:const|static|{_TYPE}|\w+_t|for|while|else|do)\b", match[1]):
            before = source.code[start : match.start()].rstrip()
            if before[-1:] in (";", "{", "}", ""):
                found.append(match.span(1))
    return found
