"""The verdict as one sentence, for the top of a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from zerodrift.diagnosis.diagnosis import CandidateReport, Diagnosis, write_probability

LABELS = {
    "missing": "An effect is missing",
    "lookalikes": "An effect is missing; look-alikes",
    "complete": "Nothing is missing",
    "unknown": "An effect that the catalogue does not know",
    "wrong data": "The logs hold wrong data",
    "not testable": "Not testable with these logs",
    "none": "No verdict",
}
NO_GAIN = 0.985
"""Held-out RMSE with a candidate over that without: above it, the candidate does not help."""
CHANCE = 0.05


@dataclass(frozen=True)
class Headline:
    """What a page says first."""

    kind: str
    """missing | lookalikes | complete | unknown | wrong data | not testable | none."""
    sentence: str

    @property
    def label(self) -> str:
        """The kind of verdict in words, so that no colour is needed to tell it."""
        return LABELS[self.kind]


def write_headline(diagnosis: Diagnosis | None, titles: Mapping[str, str]) -> Headline:
    """Return the verdict of `diagnose` in one sentence.

    Args:
        diagnosis: what was found; None where it was not asked.
        titles: effect -> the field's term.
    """
    if diagnosis is None:
        return Headline("none", "Not diagnosed: what is missing was not asked.")
    effect = diagnosis.effect
    at_floor = (
        f"the error in runs left out is {diagnosis.floor_ratio_before:.2f} times the noise floor"
    )
    if diagnosis.noise_floor_source != "dwell":
        at_floor += ", which is estimated"
    if diagnosis.verdict == "missing" and effect is not None:
        gain = (
            f"the error in runs left out falls from {diagnosis.floor_ratio_before:.2f} to "
            f"{diagnosis.floor_ratio_after:.2f} times the noise floor"
        )
        if diagnosis.lookalikes:
            names = _list_names([effect, *diagnosis.lookalikes], "or")
            return Headline(
                "lookalikes",
                f"The model lacks {names}: these logs cannot tell which. With {effect} {gain}.",
            )
        title = titles.get(effect, "")
        named = f"{effect}, {title}" if title else effect
        also = f" Missing beside it: {_list_names(diagnosis.also, 'and')}."
        return Headline(
            "missing",
            f"The model lacks {named}{diagnosis.tell_odds()}; with it {gain}."
            + (also if diagnosis.also else ""),
        )
    if diagnosis.verdict == "complete":
        if not diagnosis.candidates:
            return Headline("not testable", f"These logs can test no further effect; {at_floor}.")
        untested = len(diagnosis.not_testable)
        limit = f" that these logs can test ({untested} cannot be tested)" if untested else ""
        return Headline("complete", f"Nothing is missing{limit}; {at_floor}.")
    if runs := diagnosis.tell_wrong_runs():
        return Headline(
            "wrong data",
            f"The data of {runs} look wrong: no effect can be named before they are mended or left"
            f" out; {at_floor}.",
        )
    nearest = f" Nearest, and not all of it: {diagnosis.nearest}." if diagnosis.nearest else ""
    return Headline(
        "unknown",
        f"Something is missing that no effect of the catalogue explains; {at_floor}.{nearest}",
    )


def explain_standing(diagnosis: Diagnosis, candidate: CandidateReport) -> str:
    """Return what the diagnosis makes of a candidate, in a few words."""
    name = candidate.effect
    if name == diagnosis.effect:
        return "this one is missing"
    if name in diagnosis.lookalikes:
        return "cannot be told from it"
    if name in diagnosis.also:
        return "missing beside it"
    if name == diagnosis.nearest:
        return "nearest, and not all of it"
    if candidate.rmse_left_out_ratio >= NO_GAIN:
        return "does not lower the held-out error"
    if candidate.p_value > CHANCE:
        return "helps too few runs to rule out chance"
    return "helps, but less"


def explain_candidate(diagnosis: Diagnosis, candidate: CandidateReport) -> str:
    """Return why a candidate is what is missing, or why not, with the figures it rests on."""
    name, ratio = candidate.effect, candidate.rmse_left_out_ratio
    left = f"with it {100.0 * ratio:.1f} % of the held-out RMSE is left"
    chance = f"{write_probability(candidate.probability)} likely, p = {candidate.p_value:.2g}"
    named = next((c for c in diagnosis.candidates if c.effect == diagnosis.effect), None)
    beside = ""
    if named is not None and named is not candidate:
        beside = f", with {named.effect} {100.0 * named.rmse_left_out_ratio:.1f} %"
    standing = explain_standing(diagnosis, candidate)
    if name == diagnosis.effect:
        return f"It is what is missing: {left}, {chance}."
    if name in diagnosis.lookalikes:
        return f"It may be this one as well: {left}{beside}, {chance}; these logs cannot tell."
    if name in diagnosis.also:
        return f"It is missing too, beside the first: {left}, {chance}."
    if name == diagnosis.nearest:
        floor = f"{diagnosis.floor_ratio_before:.2f} times the noise floor now"
        return f"It comes nearest and is not all of it: {left}, {chance}, of {floor}."
    if ratio >= NO_GAIN:
        return f"Not it: it {standing}; {left}{beside}."
    if candidate.p_value > CHANCE:
        return f"Not it: it {standing} ({chance}); {left}{beside}."
    return f"Not it: it helps, but less; {left}{beside}, {chance}."


def _list_names(names: Sequence[str], word: str) -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {word} {names[-1]}"
