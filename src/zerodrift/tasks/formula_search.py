"""Searches for a formula, and compares it with black boxes and by its cost on the chip."""

from collections.abc import Callable
from dataclasses import replace

from zerodrift.base.config import Config
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.formula.proposal import FormulaSearch, propose_formula
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit_config
from zerodrift.report.results import ProposedCost
from zerodrift.tasks.formula_cost import measure_cost
from zerodrift.tasks.propose import FormulaAnswer
from zerodrift.train.black_box.compare import BlackBoxes, try_black_boxes


def search_formula(
    config: Config, dataset: Dataset, say: Callable[[str], None], *, black_box: bool = True
) -> FormulaAnswer:
    """Return a formula for what no effect explains, or that there is none; no file is written.

    Args:
        config: the project.
        dataset: its runs.
        say: called with a description of each stage of the work.
        black_box: whether a lag bank and a GRU are tried on the same runs.

    Raises:
        InputError: as `propose_formula` and `try_black_boxes`.
    """
    catalogue = load_catalogue(config.plugin_files)
    found = propose_formula(config, dataset, catalogue, lambda name: say(f"tried {name}"))
    boxes = _try_boxes(config, dataset, found, say) if black_box and found.forms else None
    if found.formula is None:
        return FormulaAnswer(found, boxes, ProposedCost({}, {}, {}), "")
    say("counting what it costs on the chip")
    return FormulaAnswer(found, boxes, *measure_cost(config, dataset, found.formula))


def _try_boxes(
    config: Config, dataset: Dataset, found: FormulaSearch, say: Callable[[str], None]
) -> BlackBoxes:
    """Return the errors of black boxes on the training runs, to compare the formula with."""
    train = replace(dataset, test=())
    if found.formula is None:
        model = fit_config(config, train, load_catalogue(config.plugin_files))
        return try_black_boxes(model, None, train, model.tared, say)
    revision = found.formula.revision
    return try_black_boxes(revision.before.model, revision.after.model, train, revision.tared, say)
