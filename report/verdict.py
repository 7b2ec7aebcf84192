"""The verdict as one sentence, for the top of a page."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Headline:
    """What a page says first."""

    kind: str
    """missing | lookalikes | complete | unknown | not testable | none."""
    sentence: str


def write_headline(diagnosed: Mapping[str, Any] | None, titles: Mapping[str, str]) -> Headline:
    """Return the verdict of `diagnose` in one sentence.

    Args:
        diagnosed: the JSON of `diagnose`; None where it was not asked.
        titles: effect -> the field's term.
    """
    if diagnosed is None:
        return Headline("none", "Not diagnosed: what is missing was not asked.")
    effect = diagnosed["effect"]
    at_floor = f"the held-out error is {diagnosed['floor_ratio_before']:.2f} times the noise floor"
    if diagnosed["floor"] != "dwell":
        at_floor += ", which is estimated"
    if diagnosed["verdict"] == "missing" and effect is not None:
        gain = (
            f"the held-out error falls from {diagnosed['floor_ratio_before']:.2f} to "
            f"{diagnosed['floor_ratio_after']:.2f} times the noise floor"
        )
        if diagnosed["lookalikes"]:
            names = _list_names([effect, *diagnosed["lookalikes"]], "or")
            return Headline(
                "lookalikes",
                f"The model lacks {names}: these logs cannot tell which. With {effect} {gain}.",
            )
        title = titles.get(effect, "")
        named = f"{effect}, {title}" if title else effect
        also = f" Missing beside it: {_list_names(diagnosed['also'], 'and')}."
        return Headline(
            "missing",
            f"The model lacks {named}; with it {gain}." + (also if diagnosed["also"] else ""),
        )
    if diagnosed["verdict"] == "complete":
        if not diagnosed["candidates"]:
            return Headline("not testable", f"These logs can test no further effect; {at_floor}.")
        untested = len(diagnosed["not_testable"])
        limit = f" that these logs can test ({untested} cannot be tested)" if untested else ""
        return Headline("complete", f"Nothing is missing{limit}; {at_floor}.")
    nearest = f" Nearest, and not it: {diagnosed['nearest']}." if diagnosed["nearest"] else ""
    return Headline(
        "unknown",
        f"Something is missing that no effect of the catalogue explains; {at_floor}.{nearest}",
    )


def _list_names(names: list[str], word: str) -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"
