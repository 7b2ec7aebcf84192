"""`zerodrift twin --loop`: plan, record and diagnose over a simulated sensor until it is sure."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from zerodrift.base.config import parse_config
from zerodrift.dataset.runs import Dataset
from zerodrift.diagnosis.changes import extend_model
from zerodrift.diagnosis.course import MOST_ADDED
from zerodrift.diagnosis.diagnose import diagnose_config
from zerodrift.diagnosis.diagnosis import Diagnosis
from zerodrift.discovery.criterion import expect_verdicts
from zerodrift.discovery.plan import (
    NothingLeftError,
    Planned,
    Question,
    find_open,
    plan_experiment,
)
from zerodrift.discovery.summary import list_protocols
from zerodrift.physics.catalogue import load_catalogue
from zerodrift_lab.twin.played import play_protocols
from zerodrift_lab.twin.project import render_config, to_dataset, to_run
from zerodrift_lab.twin.recipe import Recipe
from zerodrift_lab.twin.sensor import OUTPUTS, UNITS
from zerodrift_lab.twin.simulate import Simulation, simulate
from zerodrift_lab.twin.six_axis.protocol import parse_protocol

LIMITS = """
[experiment]
temperature_degC = [-20, 60]
heating_K_per_min = 4
cooling_K_per_min = 4

[experiment.loads]
Fx = { range = [-120, 120], hold_s = 100 }
Fy = { range = [-120, 120], hold_s = 100 }
Fz = { range = [-400, 400], hold_s = 100 }
Mx = { range = [-2.8, 2.8], hold_s = 100 }
My = { range = [-2.8, 2.8], hold_s = 100 }
Mz = { range = [-4, 4], hold_s = 100 }
"""
"""What the twin's own chamber programme moves."""
ROUND_HOURS = 2.0
LEAST_HOURS = 0.5
SEARCH_S = 15.0


@dataclass(frozen=True)
class Round:
    """One turn of the loop."""

    hours: float
    """Spent until then, those of the first logs included."""
    runs: int
    verdict: str
    effect: str | None
    lookalikes: tuple[str, ...]
    predicted: float | None
    """Probability of the right verdict that the plan before it gave; None for the first."""

    def explain(self) -> str:
        """Return it in a line."""
        told = f"{self.hours:5.2f} h  {self.runs:3d} runs  {self.verdict}"
        told += f", {self.effect}" if self.effect else ""
        told += f", or {', '.join(self.lookalikes)}" if self.lookalikes else ""
        return told + (f" (predicted {self.predicted:.2f})" if self.predicted is not None else "")


@dataclass(frozen=True)
class Looped:
    """The loop from its first logs to its end."""

    rounds: tuple[Round, ...]
    ended: str
    """sure: nothing more is missing, on runs enough; nothing left | hours spent."""
    added: tuple[str, ...]
    """Effects that were named and added to the model, in this order."""
    hidden: tuple[str, ...]
    """The truth."""


def run_loop(
    recipe: Recipe, hours: float, say: Callable[[str], None] = lambda text: None
) -> Looped:
    """Plan, record and diagnose over a simulated sensor until nothing more is missing.

    What is named and has no look-alikes is added to the model, and the same logs are asked again.

    Args:
        recipe: the sensor, and the logs that there are to begin with.
        hours: in all, those of the first logs included.
        say: told how far it is.

    Raises:
        InputError: the recipe cannot be simulated.
    """
    simulation = simulate(recipe)
    text = render_config(simulation).replace("\n[network]", LIMITS + "\n[network]", 1)
    config = parse_config(text, Path().absolute() / "zerodrift.toml")
    catalogue = load_catalogue()
    dataset = to_dataset(simulation)
    spent = sum(len(run) * run.sample_period_s for run in dataset.train) / 3600.0
    rounds: list[Round] = []
    predicted: float | None = None
    added: list[str] = []

    def end(why: str) -> Looped:
        hidden = tuple(choice.name for choice in recipe.hidden)
        return Looped(tuple(rounds), why, tuple(added), hidden)

    while True:
        say("diagnosing")
        found = diagnose_config(config, dataset)
        rounds.append(_note(found, dataset, spent, predicted))
        say(rounds[-1].explain())
        predicted = None
        if found.effect is not None and not found.lookalikes and len(added) < MOST_ADDED:
            added.append(found.effect)
            kept = extend_model(config.effects, catalogue, found.effect, found.parameters)
            config = replace(config, effects=kept)
            continue
        left = hours - spent
        try:
            find_open(found, len({run.group for run in dataset.train}))
            if left < LEAST_HOURS:
                return end("hours spent")
            question = Question(hours=min(ROUND_HOURS, left), budget_s=SEARCH_S)
            planned = plan_experiment(config, dataset, catalogue, question, say)
        except NothingLeftError:
            return end("sure" if found.verdict == "complete" else "nothing left")
        predicted = float(expect_verdicts(planned.told).mean())
        dataset = extend(simulation, dataset, planned, len(rounds))
        spent += planned.programme.hours


def extend(simulation: Simulation, dataset: Dataset, planned: Planned, number: int) -> Dataset:
    """Return the logs with those of a plan behind them, as the twin records them."""
    units = dict(zip(OUTPUTS, UNITS, strict=True))
    texts = list_protocols(planned.programme, planned.limits, units)
    protocols = {
        f"planned_{number}_{ending.removesuffix('.txt')}": parse_protocol(
            text, f"plan_{ending}", "planned"
        )
        for ending, text in texts.items()
    }
    runs = play_protocols(simulation, protocols)
    added = tuple(to_run(run, simulation.recipe) for run in runs)
    return replace(dataset, train=(*dataset.train, *added))


def _note(found: Diagnosis, dataset: Dataset, spent: float, predicted: float | None) -> Round:
    return Round(
        round(spent, 3),
        len(dataset.train),
        found.verdict,
        found.effect,
        found.lookalikes,
        None if predicted is None else round(predicted, 3),
    )


def describe_loop(looped: Looped) -> str:
    """Return the rounds, how it ended, and the truth."""
    lines = ["Plan, record, diagnose over a simulated sensor:"]
    lines += [f"  {one.explain()}" for one in looped.rounds]
    added = ", ".join(looped.added) or "nothing"
    hidden = ", ".join(looped.hidden) or "nothing"
    ended = f"Ended: {looped.ended}. Added: {added}. Hidden in fact: {hidden}."
    return "\n".join([*lines, ended])
