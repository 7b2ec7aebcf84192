"""How much more a black box learns than a formula, on runs left out."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve

from zerodrift.base.arrays import Array
from zerodrift.base.extras import TRAIN, is_there, tell_install
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.held_out import LEAVE_ONE_RUN_OUT, HeldOut, hold_out
from zerodrift.diagnosis.judgement import Fitted, judge
from zerodrift.diagnosis.run_errors import collect_errors
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.model import PhysicalModel
from zerodrift.train.black_box.signals import (
    ELAPSED,
    Lesson,
    average,
    choose_block,
    measure_unit,
    pose,
)
from zerodrift.train.lag_bank.search import LONGEST_SHARE
from zerodrift.train.refits import split_parts

# A lag bank over every signal: levels, lags and products, solved by least squares in seconds.
#
# Of each signal the bank has the level and its low-passes. Of one signal or of two it has all
# products of two of these and their cubes; of all signals together the powers alone, for there
# would be more products than rows. Which of these banks is taken, and how strongly its coefficients
# are held towards zero, is decided for each part of the runs without that part.

MOST_ROWS = 6_000
"""Block means of all runs together that a bank is fitted to."""
LAGS = 5
"""Low-passes of each signal."""
SHORTEST_STEPS = 5.0
RIDGES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Of the mean square of a column."""
KEPT = 1e-9
"""Ridge of the constant, which is not held."""


@dataclass(frozen=True)
class _Trial:
    """One bank and ridge."""

    picked: tuple[int, ...]
    """Numbers of the signals; empty: all, without products."""
    ridge: float
    squares: Array
    """[G, G] mean squared error of part h when it is left out together with part g."""


@dataclass(frozen=True)
class LearntBank:
    """The predictions that banks add to a model in runs that they did not learn from."""

    added: Mapping[str, Array]
    """Run's name -> [n, K]."""
    sees: str
    """The signals of the bank that most runs are given."""


def learn_bank(lesson: Lesson) -> LearntBank:
    """Return what is learnt of each part of the runs from the others, choice of the bank included.

    Args:
        lesson: what to learn, from three runs or more.
    """
    parts = split_parts(lesson.runs)
    owner = [next(g for g, part in enumerate(parts) if run.group in part) for run in lesson.runs]
    views = [_view(signals, lesson) for signals in lesson.signals]
    block = choose_block(lesson.runs, MOST_ROWS)
    reduced = [[average(x, block) for x in run] for run in views]
    unit = measure_unit(lesson)
    targets = [average(rest / unit, block) for rest in lesson.rests]
    trials: list[_Trial] = []
    for picked in _list_banks(lesson.names):
        solver = _Solver([_expand(run, picked) for run in reduced], targets, owner, lesson)
        trials += [_Trial(picked, ridge, solver.measure_pairs(ridge)) for ridge in RIDGES]
    squares = np.stack([trial.squares for trial in trials])
    chosen = [trials[int(np.argmin(squares[:, g].sum(axis=1)))] for g in range(len(parts))]
    added = {}
    for g, trial in enumerate(chosen):
        columns = [_expand(run, trial.picked) for run in reduced]
        solver = _Solver(columns, targets, owner, lesson)
        coefficients = solver.solve((g,), trial.ridge)
        for run, view, part in zip(lesson.runs, views, owner, strict=True):
            if part == g:
                x = solver.scale(_expand(view, trial.picked))
                added[run.name] = x @ coefficients * unit
    most = max(chosen, key=lambda one: sum(other.picked == one.picked for other in chosen))
    sees = " and ".join(lesson.names[s] for s in most.picked)
    return LearntBank(added, sees or "all signals")


def _view(signals: Array, lesson: Lesson) -> list[Array]:
    """Return the level and lags [n, V] of each signal [n, S] of a run."""
    period_s = lesson.runs[0].sample_period_s
    longest_s = period_s * max(len(run) for run in lesson.runs)
    taus_s = np.geomspace(SHORTEST_STEPS * period_s, LONGEST_SHARE * longest_s, LAGS)
    return [
        x[:, None]
        if name == ELAPSED
        else np.stack([x, *(lowpass(x, period_s, float(tau)) for tau in taus_s)], axis=1)
        for name, x in zip(lesson.names, signals.T, strict=True)
    ]


def _list_banks(names: Sequence[str]) -> Iterator[tuple[int, ...]]:
    yield ()
    for count in (1, 2):
        yield from itertools.combinations(range(len(names)), count)


def _expand(views: Sequence[Array], picked: tuple[int, ...]) -> Array:
    """Return the bank's columns [n, J], the constant first."""
    z = np.concatenate([views[s] for s in picked] if picked else list(views), axis=1)
    if picked:
        first, second = np.triu_indices(z.shape[1])
        squares = z[:, first] * z[:, second]
    else:
        squares = z**2
    return np.concatenate([np.ones((len(z), 1)), z, squares, z**3], axis=1)


class _Solver:
    """Sums of products of a bank's columns, so that any part can be left out.

    Args:
        columns: [n, J] per run.
        targets: [n, K] per run.
        owner: part of each run.
        lesson: whose runs they are.
    """

    def __init__(
        self,
        columns: Sequence[Array],
        targets: Sequence[Array],
        owner: Sequence[int],
        lesson: Lesson,
    ) -> None:
        together = np.concatenate(columns)
        self._mean = together.mean(axis=0)
        self._rms = np.maximum(together.std(axis=0), 1e-9)
        self._mean[0], self._rms[0] = 0.0, 1.0
        self._parts = []
        for g in range(max(owner) + 1):
            rows = []
            for group in lesson.name_groups():
                own = [
                    np.concatenate([self.scale(x), y], axis=1)
                    for x, y, run, part in zip(columns, targets, lesson.runs, owner, strict=True)
                    if part == g and run.group == group
                ]
                if own:
                    joined = np.concatenate(own)
                    rows.append(joined - joined.mean(axis=0) if lesson.tared else joined)
            self._parts.append(np.concatenate(rows))
        self._width = columns[0].shape[1]
        self._sums = np.stack([rows.T @ rows for rows in self._parts])
        self._rows = np.array([len(rows) for rows in self._parts])

    def scale(self, x: Array) -> Array:
        """Return columns at mean 0 and RMS 1, the constant as it is."""
        return np.asarray((x - self._mean) / self._rms)

    def solve(self, without: tuple[int, ...], ridge: float) -> Array:
        """Return the coefficients [J, K] of a fit to all parts but some."""
        others = [g for g in range(len(self._parts)) if g not in without]
        total, j = self._sums[others].sum(axis=0), self._width
        held = np.full(j, ridge)
        held[0] = KEPT
        normal = total[:j, :j] + self._rows[others].sum() * np.diag(held)
        return np.asarray(solve(normal, total[:j, j:], assume_a="pos"))

    def measure_pairs(self, ridge: float) -> Array:
        """Return [G, G] the mean squared error of part h when g is left out with it; 0 for g."""
        count, j = len(self._parts), self._width
        found = np.zeros((count, count))
        for g, h in itertools.combinations(range(count), 2):
            coefficients = self.solve((g, h), ridge)
            for one, other in ((g, h), (h, g)):
                rows = self._parts[other]
                found[one, other] = np.mean((rows[:, j:] - rows[:, :j] @ coefficients) ** 2)
        return found


# How much more a black box learns than a formula, on runs left out.

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

    def tell(done: float) -> None:
        say(f"what a GRU learns: {100.0 * done:.0f} %")

    from zerodrift.train.black_box.network import learn_network

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
