"""What the commands say of a case, held against its truth."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from benchmarks.evidence.conditions import Ask
from benchmarks.evidence.sources import CannotDrawError, Drawn, draw
from zerodrift.base.config import EffectConfig
from zerodrift.base.errors import InputError
from zerodrift.diagnosis.changes import propose_forms
from zerodrift.diagnosis.diagnose import diagnose
from zerodrift.diagnosis.diagnosis import LIKELY, Diagnosis
from zerodrift.diagnosis.revision import Revision, revise_best
from zerodrift.physics.catalogue import load_catalogue
from zerodrift.physics.fit import fit_config

MOST_STEPS = 6
FORMS_TRIED = 5
"""Candidates, the best ones, that are tried in the place of what is outside the catalogue."""
IMITATED = 2.0
"""Error on unseen runs over the noise below which a form of the catalogue is as good a name."""


@dataclass(frozen=True)
class Step:
    """A model within the loop.

    Attributes:
        added: the effect that came last; empty at first.
        error: RMS of predicted less true drift on unseen runs over the noise, all outputs together.
        verdict: what is then said of it.
    """

    added: str
    error: float
    verdict: str


@dataclass(frozen=True)
class Row:
    """What was said of a case; names as in `diagnose --json`."""

    ask: Ask
    sensor: str = ""
    verdict: str = ""
    effect: str | None = None
    lookalikes: tuple[str, ...] = ()
    nearest: str | None = None
    also: tuple[str, ...] = ()
    """Further effects that are named."""
    probabilities: dict[str, float] = field(default_factory=dict)
    nothing_missing: float = 0.0
    something_else: float = 0.0
    floor_before: float = 0.0
    floor_after: float = 0.0
    refused_add: bool = False
    """MISSING, and `add` does not keep it."""
    reason: str = ""
    steps: tuple[Step, ...] = ()
    reachable: float = 0.0
    """Of the loop: the error with all that is hidden in the model, as `add` puts it in."""
    truth_kept: bool = False
    """Where one hidden effect was not named: whether `add` keeps it nevertheless."""
    truth_errors: tuple[float, ...] = ()
    """And the error on unseen runs before and after it, over the noise."""
    form_error: float | None = None
    """Outside the catalogue: the least error on unseen runs, over the noise, that one of its forms
    leaves in the place of what is hidden."""
    cpu_s: float = 0.0
    impossible: str = ""
    """Why the simulator could not make the case."""
    failed: str = ""
    """The error that the loader or a command ended with."""

    @property
    def group(self) -> tuple[str, ...]:
        """What is named, look-alikes included."""
        return (self.effect, *self.lookalikes) if self.effect else ()

    @property
    def counts(self) -> bool:
        """Whether there was a case."""
        return not self.impossible

    @property
    def right(self) -> bool:
        """Whether the verdict is what the truth asks for."""
        if self.ask.listed:
            return bool(set(self.group) & set(self.ask.listed))
        if self.ask.purpose == "outside":
            return self.verdict == "unknown"
        return self.verdict == "complete"

    @property
    def tells_rest(self) -> bool:
        """Whether something is named, and something else said to be missing too."""
        return self.effect is not None and (bool(self.also) or self.something_else >= LIKELY)

    @property
    def imitated(self) -> bool:
        """Whether a form of the catalogue predicts what is outside it, but for little."""
        return self.form_error is not None and self.form_error < IMITATED

    @property
    def wrong_name(self) -> bool:
        """Whether something is named, and nothing hidden is in the group."""
        return self.effect is not None and not set(self.group) & set(self.ask.listed)

    def to_plain(self) -> dict[str, object]:
        """Return what JSON holds."""
        return asdict(self)


def run_case(ask: Ask) -> Row:
    """Return what `diagnose`, and `add` after it, say of a case; of the loop, all of its steps."""
    begin = time.process_time()
    try:
        drawn = draw(ask)
        row = walk(ask, drawn) if ask.condition == "loop" else look(ask, drawn)
    except CannotDrawError as error:
        return Row(ask, impossible=str(error))
    except (InputError, ArithmeticError, ValueError) as error:
        row = Row(ask, failed=f"{type(error).__name__}: {error}")
    return replace(row, cpu_s=round(time.process_time() - begin, 3))


def look(ask: Ask, drawn: Drawn) -> Row:
    """Return one diagnosis, and whether `add` keeps what it names."""
    effects = drawn.config.effects
    found = diagnose(effects, drawn.dataset, load_catalogue())
    row = tell(Row(ask, sensor=drawn.sensor), found)
    if ask.purpose == "one" and not row.right and drawn.truth:
        kept, _, after = add(drawn, effects, ask.hidden[0])
        errors = (measure(drawn, effects), measure(drawn, after))
        row = replace(row, truth_kept=kept, truth_errors=errors)
    if ask.purpose == "outside" and drawn.truth:
        row = replace(row, form_error=measure_forms(drawn, found))
    if found.effect is None:
        return row
    kept, reason, _ = add(drawn, effects, found.effect)
    return replace(row, refused_add=not kept, reason="" if kept else reason)


def tell(row: Row, found: Diagnosis) -> Row:
    """Return the row with a diagnosis in it."""
    best: dict[str, float] = {}
    for candidate in found.candidates:
        best[candidate.effect] = max(candidate.probability, best.get(candidate.effect, 0.0))
    return replace(
        row,
        verdict=found.verdict,
        effect=found.effect,
        lookalikes=tuple(found.lookalikes),
        nearest=found.nearest,
        also=tuple(found.also),
        probabilities={name: round(p, 5) for name, p in best.items()},
        nothing_missing=round(found.nothing_missing, 5),
        something_else=round(found.something_else, 5),
        floor_before=round(found.floor_ratio_before, 4),
        floor_after=round(found.floor_ratio_after, 4),
    )


def add(
    drawn: Drawn, effects: Sequence[EffectConfig], name: str
) -> tuple[bool, str, tuple[EffectConfig, ...]]:
    """Return whether `add NAME` keeps the effect, why not, and the model after it."""
    catalogue = load_catalogue()
    config = replace(drawn.config, effects=tuple(effects))
    try:
        changes = propose_forms(config, drawn.dataset, catalogue, EffectConfig(name))
        revision: Revision = revise_best(config, drawn.dataset, catalogue, changes)
    except InputError as error:
        return False, str(error), tuple(effects)
    return revision.helps, revision.reason, tuple(revision.change.effects)


def measure(drawn: Drawn, effects: Sequence[EffectConfig]) -> float:
    """Return RMS of predicted less true drift on unseen runs over the noise."""
    config = replace(drawn.config, effects=tuple(effects))
    model = fit_config(config, drawn.dataset, load_catalogue())
    missed = []
    for run, told in zip(drawn.test, model.predict_all(drawn.test), strict=True):
        error = told - drawn.truth[run.name]
        missed.append((error - error.mean(axis=0) if drawn.tared else error) / drawn.noise)
    return round(float(np.sqrt(np.mean(np.concatenate(missed) ** 2))), 4)


def measure_forms(drawn: Drawn, found: Diagnosis) -> float:
    """Return the least error on unseen runs, over the noise, with one more effect or none."""
    catalogue, effects = load_catalogue(), drawn.config.effects
    present = {effect.kind for effect in effects}
    tried = [c for c in found.candidates if c.effect not in present and c.effect in catalogue]
    errors = [measure(drawn, effects)]
    for candidate in tried[:FORMS_TRIED]:
        choices = {p.name for p in catalogue[candidate.effect].parameters if p.choices}
        held = {name: x for name, x in candidate.parameters.items() if name in choices}
        errors.append(measure(drawn, (*effects, EffectConfig(candidate.effect, held=held))))
    return min(errors)


def walk(ask: Ask, drawn: Drawn) -> Row:
    """Return the loop until nothing is missing, nothing has a name, or `add` refuses."""
    effects: tuple[EffectConfig, ...] = tuple(drawn.config.effects)
    steps: list[Step] = []
    told = effects
    for name in ask.listed:
        told = add(drawn, told, name)[2]
    row, added = Row(ask, sensor=drawn.sensor, reachable=measure(drawn, told)), ""
    while True:
        found = diagnose(effects, drawn.dataset, load_catalogue())
        row = tell(row, found)
        steps.append(Step(added, measure(drawn, effects), found.verdict))
        if found.effect is None or len(steps) > MOST_STEPS:
            return replace(row, steps=tuple(steps))
        kept, reason, after = add(drawn, effects, found.effect)
        if not kept:
            return replace(row, steps=tuple(steps), refused_add=True, reason=reason)
        effects, added = after, found.effect
