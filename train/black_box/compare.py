"""How much more a black box learns than a formula, on runs left out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from zerodrift.base.arrays import Array
from zerodrift.base.extras import TRAIN, is_there, tell_install
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.held_out import LEAVE_ONE_RUN_OUT, HeldOut, hold_out
from zerodrift.diagnosis.judgement import Fitted, judge
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.black_box.bank import learn_bank
from zerodrift.train.black_box.signals import Lesson, pose

LAG_BANK, GRU = "lag bank", "GRU"
FEWEST_RUNS = 3
"""With two, a black box would learn from one alone."""


@dataclass(frozen=True)
class BlackBox:
    """Errors of a black box on runs that it did not learn from."""

    name: str
    """lag bank | GRU."""
    sees: str
    """What it was given."""
    rmse: Array
    """[K] RMSE in the outputs' units, in the formula's place: beside the model as it is."""
    rmse_beside: Array | None
    """[K] RMSE beside model and formula; None without a formula."""
    learns_more: bool
    """Whether it is better than the formula, in its place or beside it, by what `add` asks of a
    change; without a formula, than the model as it is."""
    reason: str
    """Why, in a sentence."""


@dataclass(frozen=True)
class BlackBoxes:
    """The errors of black boxes, with those of a formula on the same runs."""

    before: Array
    """[K] RMSE on runs left out, of the model as it is."""
    after: Array | None
    """[K] with the formula."""
    boxes: tuple[BlackBox, ...]
    note: str = ""
    """Why one was not tried; empty where all were."""


def try_black_boxes(
    model: PhysicalModel,
    formula: PhysicalModel | None,
    dataset: Dataset,
    tared: bool,
    say: Callable[[str], None] = lambda text: None,
) -> BlackBoxes:
    """Return what a lag bank and a GRU learn that see every signal, each run left out in turn.

    The GRU leaves out parts of the runs where there are more than eight.

    Args:
        model: as it is, fitted to all training runs.
        formula: the same with the formula; None where there is none.
        dataset: its runs; test logs are not looked at.
        tared: whether each run's own offset is taken off the errors.
        say: called with a description of each stage of the work.

    Raises:
        InputError: the training of the GRU diverged.
    """
    models = [one for one in (model, formula) if one is not None]
    held = [hold_out(one, dataset) for one in models]
    fitted = [
        _collect(one, dataset, out.predictions, tared)
        for one, out in zip(models, held, strict=True)
    ]
    known = tuple(one.rmse for one in fitted)
    after = known[1] if formula is not None else None
    if len({run.group for run in dataset.train}) < FEWEST_RUNS:
        note = f"a black box needs {FEWEST_RUNS} training runs or more, to learn from and be tried"
        return BlackBoxes(known[0], after, (), note)
    lessons = [pose(one, dataset, tared) for one in models]
    say("what a lag bank learns")
    banks = [learn_bank(lesson) for lesson in lessons]
    boxes = [_judge(LAG_BANK, banks[0].sees, fitted, lessons, [b.added for b in banks], dataset)]
    if not is_there(TRAIN.package):
        note = f"a GRU was not tried: {TRAIN.title} is not installed ({tell_install(TRAIN.name)})"
        return BlackBoxes(known[0], after, tuple(boxes), note)
    from zerodrift.train.black_box.network import learn_network

    def tell(done: float) -> None:
        say(f"what a GRU learns: {100.0 * done:.0f} %")

    found = learn_network(lessons, tell)
    boxes.append(_judge(GRU, ", ".join(lessons[0].names), fitted, lessons, found, dataset))
    return BlackBoxes(known[0], after, tuple(boxes))


def _judge(
    name: str,
    sees: str,
    fitted: list[Fitted],
    lessons: list[Lesson],
    found: list[Mapping[str, Array]],
    dataset: Dataset,
) -> BlackBox:
    """Return a black box beside each model, judged against what is there without one."""
    tried = []
    for one, lesson, added in zip(fitted, lessons, found, strict=True):
        told = {name: lesson.without[name] + added[name] for name in lesson.without}
        tried.append(_collect(one.model, dataset, told, lesson.tared))
    reference = fitted[-1]
    verdicts = [judge(reference, one, dataset.units) for one in tried]
    helped = [reason for helps, reason in verdicts if helps]
    return BlackBox(
        name=name,
        sees=sees,
        rmse=tried[0].rmse,
        rmse_beside=tried[1].rmse if len(tried) > 1 else None,
        learns_more=bool(helped),
        reason=helped[0] if helped else verdicts[-1][1],
    )


def _collect(
    model: PhysicalModel, dataset: Dataset, predictions: Mapping[str, Array], tared: bool
) -> Fitted:
    errors = collect_errors(dataset.train, predictions, tared, model.find_usable)
    return Fitted(model, HeldOut(LEAVE_ONE_RUN_OUT, predictions), errors, errors)
