"""A formula where no effect explains what is left: searched for, held against black boxes, and
counted on the chip."""

import importlib.util
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config
from zerodrift.base.errors import CheckError, InputError
from zerodrift.base.files import write_new
from zerodrift.base.lock import make_scratch
from zerodrift.base.progress import SILENT, Progress
from zerodrift.c_runtime.cores import find_cross_compilers
from zerodrift.c_runtime.footprint import measure_footprint
from zerodrift.codegen.generate import generate
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.formula.proposal import (
    Formula,
    FormulaSearch,
    is_proposed,
    propose_formula,
    render_file,
    trace_formula,
)
from zerodrift.export.compose import (
    compose_integer_model,
    describe_compensator,
    encode_inputs,
    predict_integer,
)
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.fit import fit_config
from zerodrift.physics.model import PhysicalModel
from zerodrift.physics.summary import ParameterInterval, describe_coefficients
from zerodrift.report.results import (
    ProposedBlackBox,
    ProposedCost,
    ProposedError,
    ProposedRival,
    ProposeResult,
)
from zerodrift.report.sentences import explain_proposal
from zerodrift.tasks.project import ProjectFolder, open_project
from zerodrift.tasks.survey import keep_proposal
from zerodrift.tasks.trust import remember
from zerodrift.train.black_box.compare import BlackBoxes, try_black_boxes
from zerodrift.train.prepare import read_settings, stand_alone
from zerodrift.verify.chip_check import COUNTED_STEPS

CORE = "cortex-m4"


@dataclass(frozen=True)
class ProposeRequest:
    """What `propose` is asked."""

    project: ProjectFolder
    file: Path | None = None
    """Where the formula is written as a file of effects."""
    black_box: bool = True
    """Whether a lag bank and a GRU are tried on the same runs."""

    def __post_init__(self) -> None:
        """Refuse a place that cannot be written, before anything is read.

        Raises:
            InputError: it is no Python file, or is there and was not written by this command.
        """
        file = self.file
        if file is None:
            return
        if file.suffix != ".py":
            raise InputError(
                f"--write {file}: expected a name that ends in .py, as [plugins] takes."
            )
        try:
            # a formula that was written may be the same: a command cut off can be given again
            if is_proposed(file.read_text(encoding="utf-8")):
                return
        except FileNotFoundError:
            return
        except UnicodeDecodeError:
            pass
        raise InputError(f"--write {file}: is there already; name another file, or remove it.")

    def require_written(self, result: ProposeResult) -> None:
        """Raise where a formula was found that could not be written.

        Raises:
            InputError: the file holds another formula.
        """
        if self.file is not None and result.found and result.written is None:
            raise InputError(
                f"--write {self.file}: holds another formula, and is as it was; name another file,"
                " or remove it."
            )


@dataclass(frozen=True)
class FormulaAnswer:
    """The result of a search, with the black boxes and the cost on the chip."""

    search: FormulaSearch
    boxes: BlackBoxes | None
    """Errors of the black boxes; None: not asked for, or nothing to learn."""
    cost: ProposedCost
    cost_note: str
    """Why the cost is not known; empty where it is."""
    written: str | None = None
    """The effect's file."""

    def summarise(self, dataset: Dataset) -> ProposeResult:
        """Return the record that the command prints."""
        found, cost = self.search, self.cost
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
        boxes = self.boxes
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
            cost_note=self.cost_note,
            written=self.written,
        )


def propose(request: ProposeRequest, progress: Progress = SILENT) -> ProposeResult:
    """Return a formula for what no effect explains, or that there is none.

    It is kept in build/ for report and page, and written as the request says; `require_written`
    raises where it could not be.
    """
    config, dataset = open_project(request.project, progress)
    found = search_formula(
        config, dataset, request.project.catalogue, progress, black_box=request.black_box
    )
    file, formula = request.file, found.search.formula
    if file is not None and formula is not None and _write_once(file, render_file(formula)):
        remember((file,))
        found = replace(found, written=str(file))
    result = found.summarise(dataset)
    keep_proposal(config, dataset, result, explain_proposal(result, request.project.directory))
    return result


def search_formula(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    progress: Progress = SILENT,
    *,
    black_box: bool = True,
) -> FormulaAnswer:
    """Return a formula for what no effect explains, or that there is none; no file is written.

    Args:
        config: the project.
        dataset: its runs.
        catalogue: the known effects.
        progress: is told of each stage of the work.
        black_box: whether a lag bank and a GRU are tried on the same runs.

    Raises:
        InputError: as `propose_formula` and `try_black_boxes`.
    """
    found = propose_formula(config, dataset, catalogue, lambda name: progress(f"tried {name}"))
    boxes = (
        _try_boxes(config, dataset, catalogue, found, progress)
        if black_box and found.forms
        else None
    )
    if found.formula is None:
        return FormulaAnswer(found, boxes, ProposedCost({}, {}, {}), "")
    progress("counting what it costs on the chip")
    return FormulaAnswer(found, boxes, *measure_cost(config, dataset, found.formula))


def _try_boxes(
    config: Config,
    dataset: Dataset,
    catalogue: Catalogue,
    found: FormulaSearch,
    progress: Progress,
) -> BlackBoxes:
    """Return the errors of black boxes on the training runs, to compare the formula with."""
    train = replace(dataset, test=())
    if found.formula is None:
        model = fit_config(config, train, catalogue)
        return try_black_boxes(model, None, train, model.tared, progress)
    revision = found.formula.revision
    return try_black_boxes(
        revision.before.model, revision.after.model, train, revision.tared, progress
    )


def measure_cost(config: Config, dataset: Dataset, formula: Formula) -> tuple[ProposedCost, str]:
    """Return what the formula adds on a Cortex-M4, and why a figure is missing.

    The network is left out: its cost does not change.

    Args:
        config: the project.
        dataset: its runs.
        formula: as fitted.
    """
    revision = formula.revision
    try:
        with make_scratch(config.directory) as scratch:
            before = _measure(config, dataset, revision.before.model, scratch / "before")
            after = _measure(config, dataset, revision.after.model, scratch / "after")
    except (CheckError, InputError) as error:
        return ProposedCost({}, {}, {}), str(error)
    if before is None or after is None:
        return ProposedCost({}, {}, {}), f"no compiler or emulator for {CORE} on this machine"
    rounding = dict(zip(dataset.outputs, after[2], strict=True))
    return (
        ProposedCost({CORE: after[0] - before[0]}, {CORE: after[1] - before[1]}, rounding),
        "",
    )


def _measure(
    config: Config, dataset: Dataset, physics: PhysicalModel, folder: Path
) -> tuple[int, int, list[float]] | None:
    """Return instructions per step, bytes of flash, and the RMS [K] of the quantization error."""
    if importlib.util.find_spec("unicorn") is None or not find_cross_compilers(CORE):
        return None
    # unicorn may be lacking
    from zerodrift.c_runtime.emulator import EmulatedModel

    plain = replace(config, network=replace(config.network, kind="none"))
    compensator = stand_alone(plain, dataset, physics, read_settings(plain.network))
    described = describe_compensator(compensator, plain, dataset.train)
    model = compose_integer_model(described, plain, dataset)
    code = generate(model)
    folder.mkdir()
    chip = EmulatedModel(model, code, CORE, folder)
    run = dataset.train[0]
    counts = chip.count_instructions(encode_inputs(model, run)[:COUNTED_STEPS])
    error = predict_integer(model, run) - physics.predict(run)
    rms = ((error - error.mean(axis=0)) ** 2).mean(axis=0) ** 0.5
    return max(counts), measure_footprint(code, CORE).flash_bytes, rms.tolist()


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


def _write_once(file: Path, text: str) -> bool:
    """Write a new file; return whether the place holds this text, written now or before."""
    if file.exists():
        return file.read_bytes() == text.encode()
    write_new(file, text.encode())
    return True
