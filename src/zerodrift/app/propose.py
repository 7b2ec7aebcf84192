"""What `propose` found, as its record and in sentences."""

from pathlib import Path

from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import name_directory
from zerodrift.diagnosis.formula.proposal import Formula, FormulaSearch
from zerodrift.physics.summary import ParameterInterval, describe_coefficients
from zerodrift.report.results import ProposedCost, ProposedError, ProposedRival, ProposeResult


def summarise_search(
    found: FormulaSearch, dataset: Dataset, cost: ProposedCost, cost_note: str, file: Path | None
) -> ProposeResult:
    """Return what the command prints.

    Args:
        found: the search's end.
        dataset: the runs it was made in.
        cost: what the formula adds on the chip.
        cost_note: why that could not be told.
        file: where the effect's file was asked for.
    """
    formula = found.formula
    before, after, floor = found.rmse_left_out, None, found.noise_floor
    if formula is not None:
        revision = formula.revision
        names = dataset.outputs
        before = dict(zip(names, revision.before.rmse.tolist(), strict=True))
        after = dict(zip(names, revision.after.rmse.tolist(), strict=True))
        floor = dict(zip(names, revision.floor.rms.tolist(), strict=True))
    units = dict(zip(dataset.outputs, dataset.units, strict=True))
    fitted = formula.revision.term if formula is not None else None
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
        instructions=cost.instructions,
        flash_bytes=cost.flash_bytes,
        rounding=cost.rounding,
        cost_note=cost_note,
        written=str(file) if file is not None and formula is not None else None,
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
    """Return what was found in sentences."""
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
        told.append(
            f"Wrote {result.written}. To add it: name the file under [plugins] files in "
            f"zerodrift.toml, then zerodrift add {result.kind}{where}"
        )
    else:
        told.append(f"To write it as an effect: zerodrift propose --write {result.kind}.py{where}")
    return told
