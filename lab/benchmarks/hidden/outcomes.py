"""What the diagnosis says of one case."""

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.hidden.cases import Case, make_recipe, read_simulation
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import extend_model
from zerodrift.diagnosis.course import RepeatedDiagnosis, diagnose_until_done
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit
from zerodrift_lab.twin.simulate import simulate

SHAPES = {
    "dark_current": ("doubling_K", "doubling_K"),
    "thermal_lag": ("tau_s", "tau_s"),
    "warm_up": ("tau_s", "tau_s"),
    "humidity": ("tau_s", "tau_s"),
    "thermal_hysteresis": ("half_width_K", "half_width_K"),
    "clock_delay": ("delay_s", "delay_s"),
}
"""Effect -> its parameter's name in the catalogue and in the simulator, where both mean it."""


@dataclass
class Outcome:
    """What the diagnosis said of a case."""

    case: Case
    verdict: str = ""
    effect: str | None = None
    lookalikes: list[str] = field(default_factory=list)
    nearest: str | None = None
    added: list[str] = field(default_factory=list)
    """With pairs: what repeated diagnosis added."""
    before: float = math.nan
    after: float = math.nan
    shapes: list[tuple[str, float, float, float]] = field(default_factory=list)
    """(parameter, truth, low, high)."""
    seconds: float = math.nan
    refused: str = ""
    """Why the simulator could not make the case."""

    @property
    def group(self) -> set[str]:
        """The effects named, look-alikes included."""
        return {self.effect, *self.lookalikes} if self.effect else set()

    @property
    def first(self) -> bool:
        """Whether a hidden effect was named first."""
        return self.effect in self.case.hidden

    @property
    def in_group(self) -> bool:
        """Whether it was named first, or within a group of two."""
        return self.first or (len(self.group) <= 2 and bool(self.group & set(self.case.hidden)))

    @property
    def wrong(self) -> bool:
        """Whether something was named, and nothing hidden within the group."""
        return self.effect is not None and not self.group & set(self.case.hidden)


def run_case(case: Case, change: Callable[[Dataset], Dataset] = lambda dataset: dataset) -> Outcome:
    """Return what the diagnosis says of one case.

    Args:
        case: what is simulated.
        change: what becomes of the logs before they are diagnosed.
    """
    outcome = Outcome(case)
    recipe = make_recipe(case)
    try:
        simulation = simulate(recipe)
    except InputError as error:
        outcome.refused = str(error)
        return outcome
    dataset = change(read_simulation(simulation))
    effects: Sequence[EffectConfig] = [EffectConfig(choice.name) for choice in recipe.told]
    catalogue = load_catalogue()
    course: RepeatedDiagnosis | None = None
    begin = time.process_time()
    if case.purpose == "pair":
        course = diagnose_until_done(effects, dataset, catalogue)
        diagnosis = course.steps[0]
        outcome.added = [step.effect for step in course.steps if step.effect]
    else:
        diagnosis = diagnose(effects, dataset, catalogue)
    outcome.seconds = time.process_time() - begin
    outcome.verdict, outcome.effect = diagnosis.verdict, diagnosis.effect
    outcome.lookalikes = list(diagnosis.lookalikes)
    outcome.nearest = diagnosis.nearest
    outcome.before, outcome.after = diagnosis.floor_ratio_before, diagnosis.floor_ratio_after
    if course is not None:
        outcome.after = course.steps[-1].floor_ratio_before
    if case.purpose == "one" and outcome.first:
        model = fit(
            extend_model(effects, catalogue, case.hidden[0], diagnosis.parameters),
            dataset.train,
            outputs=dataset.outputs,
            units=dataset.units,
            full_scale=dataset.full_scale,
            catalogue=catalogue,
        )
        for fitted in model.terms:
            if fitted.kind not in SHAPES:
                continue
            mine, theirs = SHAPES[fitted.kind]
            if mine in fitted.intervals and mine not in fitted.at_bound:
                truth = float(simulation.physics.parameters[fitted.kind][theirs])
                low, high = fitted.intervals[mine]
                outcome.shapes.append((f"{fitted.kind}.{mine}", truth, low, high))
    return outcome


def read_outcomes(path: Path) -> list[Outcome]:
    """Return the outcomes that an earlier run appended to a file."""
    if not path.exists():
        return []
    outcomes = []
    for line in path.read_text(encoding="utf-8").splitlines():
        plain = json.loads(line)
        case = plain.pop("case")
        case = Case(**{**case, "hidden": tuple(case["hidden"])})
        shapes = [(str(s[0]), float(s[1]), float(s[2]), float(s[3])) for s in plain.pop("shapes")]
        outcomes.append(Outcome(case, **plain, shapes=shapes))
    return outcomes
