"""The result of `propose`, as its record and in sentences."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import name_directory
from zerodrift.diagnosis.formula.curve import trace_formula
from zerodrift.diagnosis.formula.proposal import Formula, FormulaSearch
from zerodrift.physics.summary import ParameterInterval, describe_coefficients
from zerodrift.report.proposal_words import explain_black_boxes
from zerodrift.report.results import (
    ProposedBlackBox,
    ProposedCost,
    ProposedError,
    ProposedRival,
    ProposeResult,
)
from zerodrift.train.black_box.compare import BlackBoxes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FormulaAnswer:
    """The result of a search, with the black boxes and the cost on the chip."""

    search: FormulaSearch
    boxes: BlackBoxes | None
    """Errors of the black boxes; None: not asked for, or nothing to learn."""
    cost: ProposedCost
    cost_note: str
    """Why the cost is not known; empty where it is."""


def summarise_search(whole: FormulaAnswer, dataset: Dataset, file: Path | None) -> ProposeResult:
    """Return the record that the command prints.

    Args:
        whole: the result of the search.
        dataset: the runs that were searched.
        file: the effect's file, where one was asked for.
    """
    found, cost = whole.search, whole.cost
    formula = found.formula
    before, after, floor = found.rmse_left_out, None, found.noise_floor
    if formula is not None:
        revision = formula.revision
        names = dataset.outputs
        after = dict(zip(names, revision.after.rmse.tolist(), strict=True))
        floor = dict(zip(names, revision.floor.rms.tolist(), strict=True))
    units = dict(zip(dataset.outputs, dataset.units, strict=True))
    fitted = formula.revision.term if formula is not None else None
    levels = np.array([floor[name] for name in dataset.outputs])
    boxes = whole.boxes
    return ProposeResult(
        found=formula is not None,
        kind=formula.effect.kind if formula is not None else None,
        formula=formula.write() if formula is not None else None,
        parameters=_list_parameters(formula) if formula is not None else {},
        coefficients=(
            describe_coefficients(formula.revision.after.model, fitted)
            if formula is not None and fitted is not None
            else ()
        ),
        rmse_left_out={
            name: ProposedError(
                units[name], before[name], after[name] if after else None, floor[name]
            )
            for name in dataset.outputs
        },
        floor_ratio_before=found.floor_ratio_before,
        floor_ratio_after=found.floor_ratio_after,
        p_value=found.p_value,
        probability=1.0 - found.p_value
        if formula is not None and found.p_value is not None
        else None,
        forms_tried=found.forms,
        columns_tried=found.tried,
        lookalikes=tuple(
            ProposedRival(rival.name, rival.apart, rival.is_equal)
            for rival in (formula.rivals if formula is not None else ())
        ),
        suffices=found.suffices or None,
        nearest=found.nearest or None,
        reason=found.reason,
        physics=formula.meaning.physics if formula is not None else "",
        next_experiment=formula.meaning.experiment if formula is not None else "",
        remainder=found.remainder if formula is None else (),
        black_boxes=_list_black_boxes(boxes, dataset, levels) if boxes is not None else (),
        black_box_note=boxes.note if boxes is not None else "",
        curves=trace_formula(formula, dataset) if formula is not None else {},
        instructions=cost.instructions,
        flash_bytes=cost.flash_bytes,
        rounding=cost.rounding,
        cost_note=whole.cost_note,
        written=str(file) if file is not None and formula is not None else None,
    )


def _list_black_boxes(
    boxes: BlackBoxes, dataset: Dataset, floor: Array
) -> tuple[ProposedBlackBox, ...]:
    def pool(rmse: Array) -> float:
        return float(np.sqrt(np.mean((rmse / floor) ** 2)))

    def sort(rmse: Array) -> dict[str, float]:
        return dict(zip(dataset.outputs, rmse.tolist(), strict=True))

    return tuple(
        ProposedBlackBox(
            name=box.name,
            sees=box.sees,
            rmse_left_out=sort(box.rmse),
            rmse_beside=sort(box.rmse_beside) if box.rmse_beside is not None else None,
            floor_ratio=pool(box.rmse),
            floor_ratio_beside=pool(box.rmse_beside) if box.rmse_beside is not None else None,
            learns_more=box.learns_more,
            reason=box.reason,
        )
        for box in boxes.boxes
    )


def _list_parameters(formula: Formula) -> dict[str, ParameterInterval]:
    fitted = formula.revision.term
    assert fitted is not None
    return {
        p.name: ParameterInterval(
            formula.values[p.name],
            fitted.std_errors.get(p.name),
            p.unit,
            held=False,
            at_bound=p.name in fitted.at_bound,
            interval=fitted.intervals.get(p.name),
        )
        for p in formula.effect.parameters
    }


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
