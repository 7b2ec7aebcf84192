"""What a comparison, a verdict and a formula say, in sentences: for terminal, report and page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from zerodrift.diagnosis.changes import name_directory
from zerodrift.diagnosis.compare import Comparison
from zerodrift.diagnosis.diagnosis import (
    HEADLINE,
    LIKELY,
    STEP,
    CandidateReport,
    Diagnosis,
    Sentence,
    write_probability,
)
from zerodrift.diagnosis.drivers import OtherThermometer
from zerodrift.diagnosis.segments import CONCENTRATED, Pattern
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.description import write_values
from zerodrift.report.results import ProposeResult
from zerodrift.train.black_box.compare import LAG_BANK

# The verdict as one sentence, for the top of a page.

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


# What a comparison, a verdict and a formula say, in sentences: for terminal, report and page.


def explain_figures(comparison: Comparison) -> list[str]:
    """Return sentences on how far the tables' figures can be trusted."""
    sentences = [_finish(comparison.method.explain()), _finish(comparison.floor.explain())]
    if comparison.tared:
        sentences.append(
            "The logs are zeroed one by one, so a run's own offset says nothing about the model: "
            "it is taken off every error. RMS of what is taken off, beside the error: "
            + ", ".join(
                f"{name} {told.offset:.4g} beside {told.rmse:.4g} {unit}"
                for name, unit, told in zip(
                    comparison.outputs, comparison.units, comparison.told, strict=True
                )
            )
            + "."
        )
    if comparison.set_aside > 0.0:
        sentences.append(
            f"{100.0 * comparison.set_aside:.2g} % of the samples stand at a converter's rail and "
            "are set aside."
        )
    if comparison.outliers.rows:
        without = ", ".join(
            f"{name} {told.steady_rmse:.4g} {unit}"
            for name, unit, told in zip(
                comparison.outputs, comparison.units, comparison.told, strict=True
            )
        )
        sentences.append(_finish(comparison.outliers.explain()))
        sentences.append(
            f"The tables' errors are those of all rows; the RMSE without outliers is {without}."
        )
    return sentences


def _finish(sentence: str) -> str:
    return sentence[0].upper() + sentence[1:] + "."


def describe_patterns(comparison: Comparison) -> list[str]:
    """Return the patterns in sentences; outputs with the same words share one."""
    sentences = []
    concentrated: dict[str, list[Pattern]] = {}
    signed: dict[int, list[Pattern]] = {}
    for pattern in comparison.failures.patterns:
        if pattern.kind == CONCENTRATED:
            concentrated.setdefault(pattern.words, []).append(pattern)
        else:
            signed.setdefault(pattern.output, []).append(pattern)
    for words, alike in concentrated.items():
        time = _write_range([100.0 * p.share_of_time for p in alike])
        sentences.append(
            f"{_name_outputs(comparison, alike)}: {words}. {_write_error(alike)} lies in this "
            f"{time} of the time ({_write_agreement(alike)})."
        )
    by_sides: dict[tuple[str, str], list[Pattern]] = {}
    for one, other in signed.values():
        by_sides.setdefault((one.words, other.words), []).extend((one, other))
    for (here, there), alike in by_sides.items():
        pairs = zip(alike[::2], alike[1::2], strict=True)
        means = ", ".join(
            f"{comparison.outputs[p.output]} {p.mean_error:+.2g} and {q.mean_error:+.2g} "
            f"{comparison.units[p.output]}"
            for p, q in pairs
        )
        sentences.append(
            f"{_name_outputs(comparison, alike[::2])}: off one way {here}, the other way {there} "
            f"({means}). That is {_write_error(alike)} ({_write_agreement(alike)})."
        )
    return sentences


def _name_outputs(comparison: Comparison, patterns: Sequence[Pattern]) -> str:
    return ", ".join(comparison.outputs[p.output] for p in patterns)


def _write_error(patterns: Sequence[Pattern]) -> str:
    return f"{_write_range([100.0 * p.share_of_error for p in patterns])} of the squared error"


def _write_agreement(patterns: Sequence[Pattern]) -> str:
    """Return as text how many runs agree, for the output on which they agree least."""
    least = min(patterns, key=lambda p: p.runs_agreeing / p.runs_checked)
    return f"{least.runs_agreeing} of {least.runs_checked} runs left out agree"


def _write_range(percents: list[float]) -> str:
    low, high = f"{min(percents):.0f}", f"{max(percents):.0f}"
    return f"{low} %" if low == high else f"{low} to {high} %"


def explain_verdict(diagnosis: "Diagnosis", command: str, catalogue: Catalogue) -> list[Sentence]:
    """Return the verdict in sentences.

    Args:
        diagnosis: the result.
        command: the command line that adds the missing effect.
        catalogue: the known effects.
    """

    floor = f"{diagnosis.floor_ratio_before:.2f} times the noise floor"
    if diagnosis.noise_floor_source != "dwell":
        floor += " (estimated)"
    sentences: list[Sentence] = []
    thin = " (thin evidence)" if diagnosis.evidence.startswith("thin") else ""
    if diagnosis.verdict == "missing" and diagnosis.effect is not None:
        effect = catalogue[diagnosis.effect]
        named = f"{effect.kind} ({effect.title}){diagnosis.tell_odds()}"
        sentences.append(Sentence(f"MISSING{thin}: {named}.", HEADLINE))
        values = write_values(effect, diagnosis.parameters)
        if values:
            sentences.append(Sentence(f"Fitted: {values}."))
        sentences.append(
            Sentence(
                f"Error in runs left out: {floor} now, "
                f"{diagnosis.floor_ratio_after:.2f} times with it.",
                HEADLINE,
            )
        )
        if diagnosis.lookalikes:
            names = ", ".join(diagnosis.lookalikes)
            sentences.append(Sentence(f"These logs cannot tell it from: {names}.", HEADLINE))
        if diagnosis.also:
            sentences.append(Sentence(f"Missing beside it: {', '.join(diagnosis.also)}.", HEADLINE))
        sentences.append(Sentence(effect.physics))
    elif diagnosis.verdict == "complete":
        sentences.append(
            Sentence(f"COMPLETE{thin}: no effect that these logs can test helps.", HEADLINE)
        )
        sentences.append(Sentence(f"Error in runs left out: {floor}.", HEADLINE))
    else:
        sentences.append(
            Sentence(
                f"UNKNOWN{thin}: something is missing that no effect of the catalogue explains.",
                HEADLINE,
            )
        )
        sentences.append(Sentence(f"Error in runs left out: {floor}.", HEADLINE))
        if diagnosis.nearest is not None:
            sentences.append(
                Sentence(f"Nearest, and not all of it: {diagnosis.nearest}.", HEADLINE)
            )
        sentences += [
            Sentence(
                f"What is left follows {pattern.follows} ({100.0 * pattern.share:.0f} % of it)."
            )
            for pattern in diagnosis.remainder
        ]
        if not diagnosis.remainder:
            sentences.append(Sentence("What is left follows no signal in the logs."))
        if not diagnosis.wrong_runs:
            sentences.append(Sentence("To look for a formula of it: zerodrift propose", STEP))
    if diagnosis.wrong_runs:
        runs = diagnosis.tell_wrong_runs()
        sentences.append(
            Sentence(
                f"First look at {runs}, whose data look wrong (see the notes): mend them or leave "
                "them out, then diagnose again.",
                STEP,
            )
        )
    sentences.append(Sentence(f"Evidence: {diagnosis.evidence}."))
    if diagnosis.next_experiment:
        sentences.append(Sentence(f"Next experiment: {diagnosis.next_experiment}."))
    if diagnosis.lookalikes:
        sentences.append(
            Sentence("To compute the experiment that tells them apart: zerodrift plan", STEP)
        )
    if diagnosis.effect is not None:
        sentences.append(Sentence(f"To add it: {command}", STEP))
        if diagnosis.something_else >= LIKELY:
            sentences.append(
                Sentence("Then, to look for a formula of what is left: zerodrift propose", STEP)
            )
        if thin:
            sentences.append(
                Sentence(
                    "On evidence this thin `add` may refuse it; --force keeps what the hardware "
                    "has."
                )
            )
    return sentences


def explain_others(others: Sequence[OtherThermometer], directory: Path) -> list[Sentence]:
    """Return a sentence on each other thermometer that the drift follows."""
    return [
        Sentence(
            f"The drift follows another thermometer, {other.signal}: {other.reason}. "
            f"To add it: {other.command.write(directory)}"
        )
        for other in others
    ]


def explain_proposal(result: ProposeResult, directory: Path) -> list[str]:
    """Return the findings in sentences."""
    where = name_directory(directory)
    tried = (
        f"{result.forms_tried} formulas were tried, with {result.columns_tried} values of their "
        f"numbers; chance does as well as the best of them with p = {result.p_value:.2g}."
        if result.p_value is not None
        else ""
    )
    if not result.found:
        told = [f"NO FORMULA: {result.reason}."]
        if result.suffices:
            told.append(f"To add it: zerodrift add {result.suffices}{where}")
        if result.nearest and not result.suffices:
            told.append(f"Nearest, but not it: k * {result.nearest}.")
        told += [
            f"What is left follows {one.follows} ({100.0 * one.share:.0f} % of it)."
            for one in result.remainder
        ]
        if not result.remainder and result.forms_tried:
            told.append("What is left follows no signal in the logs.")
        told += explain_black_boxes(result)
        return [*told, tried] if tried else told
    told = [
        f"FORMULA: drift = {result.formula}, with coefficients of its own for each output.",
        f"Held-out error: {result.floor_ratio_before:.2f} times the noise floor now, "
        f"{result.floor_ratio_after:.2f} times with it; {result.reason}.",
        tried,
        result.physics,
    ]
    for rival in result.lookalikes:
        says = "says the same" if rival.equal else "cannot be told from it by these logs"
        told.append(f"drift = {rival.name} {says} ({rival.apart:.2f} times the noise apart).")
    told += explain_black_boxes(result)
    for core, instructions in result.instructions.items():
        rounding = ", ".join(
            f"{name} {value:.2g} {result.rmse_left_out[name].unit}"
            for name, value in result.rounding.items()
        )
        told.append(
            f"On a {core} it adds {instructions} instructions to a step and "
            f"{result.flash_bytes[core]} B of flash; in integers the model differs by an RMS of "
            f"{rounding} from float."
        )
    if result.cost_note:
        told.append(f"Its cost on the chip is not known: {result.cost_note}.")
    told.append(f"To confirm or refute it: {result.next_experiment}.")
    if result.written:
        told.append(f"Wrote {result.written}. To add it: zerodrift add {result.written}{where}")
    else:
        told.append(f"To write it as an effect: zerodrift propose --write {result.kind}.py{where}")
    return told


def explain_black_boxes(result: ProposeResult) -> list[str]:
    """Return how much more each black box learns, in sentences."""
    told = []
    for box in result.black_boxes:
        sees = (
            f"A {box.name} of {box.sees}"
            if box.name == LAG_BANK
            else f"A {box.name} of all signals"
        )
        if box.floor_ratio_beside is None:
            told.append(
                f"{sees} leaves {box.floor_ratio:.2f} times the noise floor in runs left out: "
                + (
                    "there is something to learn that no formula here says."
                    if box.learns_more
                    else "it learns nothing either."
                )
            )
            continue
        told.append(
            f"{sees} leaves {box.floor_ratio:.2f} times the noise floor in the formula's place, "
            f"{box.floor_ratio_beside:.2f} beside it: "
            + (
                f"it learns more than the formula ({box.reason})."
                if box.learns_more
                else "it learns no more than the formula."
            )
        )
    if result.black_box_note:
        told.append(f"{result.black_box_note[0].upper()}{result.black_box_note[1:]}.")
    return told
