"""Which effect a model lacks: a name, a group of look-alikes, "nothing", or an honest "unknown"."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zerodrift.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.physics.campaign import FEWEST_RUNS, Campaign
from zerodrift.physics.candidates import Untested
from zerodrift.physics.catalogue import Catalogue, load_catalogue
from zerodrift.physics.diagnosis import CandidateReport, Diagnosis
from zerodrift.physics.evidence import compare_runs, hold_in, hold_out
from zerodrift.physics.examination import Examination, Judged, examine, predict, share_explained
from zerodrift.physics.experiments import choose_experiment
from zerodrift.physics.fit import TARE_RATIO, check_terms, flat_weights
from zerodrift.physics.projection import get_coordinates, list_coordinates
from zerodrift.physics.remainder import Pattern, describe_remainder
from zerodrift.physics.search import search, sum_with_slopes
from zerodrift.physics.signals import explain_missing, plan_signals
from zerodrift.physics.terms import Term, start_term, tidy_terms

Array = NDArray[np.float64]

SIGNIFICANT = 0.05
"""Largest p-value of an effect that is named, over all candidates together."""
WORTHWHILE = 0.985
"""An effect must bring the held-out RMSE below this share of what it was, ..."""
WORTHWHILE_ON_ONE = 0.97
"""... or that of one output below this."""
AT_FLOOR = 1.1
"""Held-out RMSE over the floor of a dwell that counts as having arrived."""
AT_ESTIMATED_FLOOR = 1.4
"""The same for a floor that was estimated, which is a lower bound."""
EXPLAINED = 0.95
"""Share of the excess over the floor that an effect of nearly the right form explains."""
LEFT_WITHOUT_DWELL = 0.5
"""Share of the held-out squared error that an effect may leave where no dwell tells the floor."""
CONCENTRATED = 0.8
"""An effect seen in too few runs for a small p-value must explain this share of the excess, ..."""
ALL_GAIN = 0.95
"""... and hardly lose anywhere."""
ALIKE = 0.02
"""Effects whose gains differ by less than this share cannot be told apart, ..."""
ALIKE_UNLESS_SURE = 0.1
"""... nor by less than this if the runs do not agree on it, ..."""
ALIKE_UNITS = 10.0
"""... nor by less than this in noise units."""
IMPLAUSIBLE = 0.97
"""An effect with values far from typical gives way to one with this share of its gain."""
MOST_EFFECTS = 4
"""Effects that are looked for together before giving up."""
SHORTLIST = 6
"""Effects that are tried again in each other's presence."""
WANDERING = 0.4
"""Share of slow variance in a dwell above which the sensor wanders even at rest."""
SLOW_S, SLOW_SAMPLES = 60.0, 64.0
"""Noise with longer memory than both counts as slow."""
ENOUGH_RUNS = 6
"""Fewer runs than this are thin evidence, and said to be."""
WANTED_RUNS = 8

Advance = Callable[[str], None]


@dataclass(frozen=True)
class Finding:
    """One missing effect with the examination it came from."""

    examination: Examination
    judged: Judged


def diagnose_config(
    config: Config, dataset: Dataset, advance: Advance = lambda kind: None
) -> Diagnosis:
    """Return which effect the model of zerodrift.toml lacks.

    Args:
        config: the project.
        dataset: its runs.
        advance: called with each effect's name when it has been tried.

    Raises:
        InputError: as `fit_config`.
    """
    return diagnose(config.effects, dataset, load_catalogue(config.plugin_files), advance)


def diagnose(
    effects: Sequence[EffectConfig],
    dataset: Dataset,
    catalogue: Catalogue | None = None,
    advance: Advance = lambda kind: None,
) -> Diagnosis:
    """Return which effect a model lacks, from its training runs.

    Args:
        effects: the model's `[[effect]]` tables.
        dataset: its runs.
        catalogue: the known effects; by default the built-ins.
        advance: called with each effect's name when it has been tried.
    """
    catalogue = catalogue or load_catalogue()
    return Diagnostician(dataset, catalogue, effects, advance).conclude()


class Diagnostician:
    """The runs of a project, its catalogue and its model, looked at until a verdict stands.

    Args:
        dataset: the runs.
        catalogue: the known effects.
        effects: the model's `[[effect]]` tables.
        advance: called with each effect's name when it has been tried.
    """

    def __init__(
        self,
        dataset: Dataset,
        catalogue: Catalogue,
        effects: Sequence[EffectConfig],
        advance: Advance,
    ) -> None:
        self.dataset = dataset
        self.catalogue = catalogue
        self.advance = advance
        self.plan = plan_signals(dataset.train, dataset.outputs, dataset.full_scale)
        self.terms = tuple(start_term(catalogue, config) for config in effects)
        check_terms(self.terms, effects, self.plan)
        self.campaign = self._lay_out()

    def _lay_out(self) -> Campaign:
        """Return the runs with offsets of their own, unless they share one."""
        runs, order = self.dataset.train, list(self.catalogue)
        tared = Campaign(runs, self.plan, order, set_aside=True)
        if len(tared.groups) == 1:
            return Campaign(runs, self.plan, order, tared=False, set_aside=True)
        own = search(tared, self.terms, flat_weights(tared))
        common = Campaign(runs, self.plan, order, tared=False, set_aside=True)
        shared = search(common, own.terms, flat_weights(common), vary=())
        ratio = float(np.mean(shared.solution.errors / own.solution.errors))
        return common if ratio < TARE_RATIO else tared

    def conclude(self) -> Diagnosis:
        """Return the verdict."""
        first = self.look(self.terms)
        findings, last = self.find_missing(first)
        rails = self.look_at_rails(first)
        if rails is not None and self.helps(rails):
            first = self._with_rails(first, rails)
            findings = self._place_rails(first, rails, findings)
        if not findings:
            complete = self.arrived(first, first.fitted_ratio) and not self.wanders(first)
            return self._report("complete" if complete else "unknown", first, None, ())
        left = findings[-1].judged.fitted_ratio if last is None else last.fitted_ratio
        if len(findings) > 1:
            findings = self.confirm(findings)
        share = share_explained(first.fitted_ratio**2, left**2)
        explained = self.arrived(first, left) or share >= EXPLAINED
        if not self.dataset.dwell:
            # A floor that is a lower bound cannot refuse; a large held-out gain must do.
            explained = explained or findings[0].judged.rmse_ratio ** 2 <= LEFT_WITHOUT_DWELL
        if not explained:
            return self._report("unknown", first, findings[0], ())
        return self._report("missing", first, findings[0], tuple(findings[1:]))

    def look(self, terms: Sequence[Term], kinds: frozenset[str] | None = None) -> Examination:
        """Return what every effect that `terms` lack would gain."""
        return examine(
            self.campaign,
            self.dataset.dwell,
            self.catalogue,
            terms,
            kinds=kinds,
            advance=self.advance,
        )

    def find_missing(self, first: Examination) -> tuple[list[Finding], Examination | None]:
        """Return missing effects, the strongest first, each beside those before it.

        The last examination, in which nothing more helped, is None where the floor was reached.
        """
        findings: list[Finding] = []
        examination = first
        while len(findings) < MOST_EFFECTS:
            leading = self.lead(examination)
            if leading is None:
                return findings, examination if findings else None
            findings.append(Finding(examination, leading))
            if self.arrived(examination, leading.fitted_ratio):
                return findings, None
            examination = self.look(leading.found.terms)
        return findings, examination

    def confirm(self, findings: Sequence[Finding]) -> list[Finding]:
        """Return several missing effects tried once more, each in the presence of the others.

        The first was chosen while the others were still missing, so it may be a mere resemblance.
        """
        shortlist = {j.kind for f in findings for j in f.examination.judged[:SHORTLIST]}
        told = {term.effect.kind: term for term in self.terms}
        best: dict[str, Finding] = {}
        terms = findings[-1].judged.found.terms
        for kind in [finding.judged.kind for finding in findings]:
            others = _without(terms, kind, told)
            if others == terms:
                continue
            wanted = shortlist - {t.effect.kind for t in others if t.effect.kind not in told}
            examination = self.look(others, frozenset(wanted))
            leading = self.lead(examination)
            if leading is not None:
                best[leading.kind] = Finding(examination, leading)
                terms = leading.found.terms
        rails = [f for f in findings if self.catalogue[f.judged.kind].sets_aside]
        confirmed = sorted(best.values(), key=lambda f: -f.judged.gain)
        return rails + confirmed if confirmed else list(findings)

    def lead(self, examination: Examination) -> Judged | None:
        """Return the effect to name: the one with most gain, unless its values are implausible."""
        helpful = [judged for judged in examination.judged if self.helps(judged)]
        if not helpful:
            return None
        best = helpful[0]
        if best.plausible:
            return best
        rivals = [j for j in helpful if j.plausible and j.gain >= IMPLAUSIBLE * best.gain]
        return rivals[0] if rivals else best

    def helps(self, judged: Judged) -> bool:
        """Return whether an effect's held-out gain is real and worth having."""
        worthwhile = (
            judged.rmse_ratio <= WORTHWHILE or judged.best_output_ratio <= WORTHWHILE_ON_ONE
        )
        reachable = 2.0 ** -float(judged.gains.size)
        sure = judged.p_value <= max(SIGNIFICANT, reachable)
        # Seen in a few runs only, sign flips cannot be sure; reaching the floor by one effect can.
        clear = judged.share >= CONCENTRATED and judged.positive_share >= ALL_GAIN
        return worthwhile and judged.gain > 0.0 and (sure or clear)

    def list_lookalikes(self, finding: Finding) -> list[Judged]:
        """Return the effects that these data cannot tell from the one found."""
        leading = finding.judged
        alike = []
        for judged in finding.examination.judged:
            if judged.kind == leading.kind or not self.helps(judged):
                continue
            behind = leading.gain - judged.gain
            close = behind <= max(ALIKE_UNITS, ALIKE * leading.gain)
            unsure = compare_runs(leading.gains, judged.gains) > SIGNIFICANT
            if close or (unsure and behind <= ALIKE_UNLESS_SURE * leading.gain):
                alike.append(judged)
        return alike

    def arrived(self, examination: Examination, ratio: float) -> bool:
        """Return whether an RMSE of so many floors is at the floor, as well as that is known."""
        if not self.dataset.dwell:
            return ratio <= AT_ESTIMATED_FLOOR
        return ratio <= AT_FLOOR + 2.0 * examination.noise.uncertainty

    def wanders(self, examination: Examination) -> bool:
        """Return whether the dwell wanders slowly, which no noise of a converter does."""
        if not self.dataset.dwell:
            return False
        noise = examination.noise
        slowest = max(SLOW_SAMPLES, SLOW_S / self.plan.sample_period_s)
        slow = noise.weights[noise.tau_samples > slowest].sum(axis=0)
        return float(np.mean(slow / np.maximum(noise.weights.sum(axis=0), 1e-300))) > WANDERING

    def list_idle(self) -> tuple[str, ...]:
        """Return the effects of the model without which runs left out are predicted as well."""
        idle = []
        for term in self.terms:
            if term.effect.sets_aside:
                continue
            others = tuple(other for other in self.terms if other is not term)
            examination = self.look(others, frozenset({term.effect.kind}))
            if self.lead(examination) is None:
                idle.append(term.effect.kind)
        return tuple(idle)

    # --- rails ----------------------------------------------------------------------------------

    def look_at_rails(self, first: Examination) -> Judged | None:
        """Return what setting samples at a converter's rail aside gains, if there are any."""
        known = any(term.effect.sets_aside for term in self.terms)
        kinds = [kind for kind, effect in self.catalogue.items() if effect.sets_aside]
        if known or not kinds or not self.plan.saturated:
            return None
        raw = Campaign(
            self.dataset.train,
            self.plan,
            list(self.catalogue),
            tared=self.campaign.tared,
            set_aside=False,
        )
        coordinates = list_coordinates(first.base.terms)
        position = get_coordinates(first.base.terms, coordinates)
        scores, errors, left = [], [], []
        for campaign in (raw, self.campaign):
            sums = sum_with_slopes(campaign, first.base.terms, coordinates)
            out = hold_out(sums, first.weights, coordinates, position, campaign.unit_of_piece)
            units = campaign.unit_of_piece
            scores.append(np.asarray(np.bincount(units, weights=out.score(first.weights)), float))
            errors.append(out.mean_squares(campaign.means) / first.floor**2)
            inside = hold_in(sums, first.weights).mean_squares(campaign.means)
            left.append(float(np.mean(inside / first.floor**2)))
        effect = self.catalogue[kinds[0]]
        term = start_term(self.catalogue, EffectConfig(effect.kind))
        return Judged(
            kind=effect.kind,
            parameters={},
            found=replace(first.base, terms=(*first.base.terms, term)),
            excitation=1.0,
            plausible=True,
            gains=scores[0] - scores[1],
            # Seen, not inferred: noise does not repeat an extreme to the last digit.
            p_value=0.0,
            rmse_ratio=float(np.sqrt(np.mean(errors[1]) / np.mean(errors[0]))),
            best_output_ratio=float(np.sqrt(np.min(errors[1] / errors[0]))),
            floor_ratio=float(np.sqrt(np.mean(errors[1]))),
            fitted_ratio=float(np.sqrt(left[1])),
            share=share_explained(left[0], left[1]),
        )

    def _with_rails(self, first: Examination, rails: Judged) -> Examination:
        """Return the first examination with the samples at a rail counted among its errors."""
        held_out = (rails.floor_ratio / rails.rmse_ratio / first.floor_ratio) ** 2
        before = rails.fitted_ratio**2
        if rails.share < 1.0:
            before = (before - rails.share) / (1.0 - rails.share)
        judged = sorted((*first.judged, rails), key=lambda j: -j.gain)
        return replace(
            first,
            base_errors=first.base_errors * held_out,
            base_left=first.base_left * before / first.fitted_ratio**2,
            judged=tuple(judged),
        )

    def _place_rails(
        self, first: Examination, rails: Judged, findings: Sequence[Finding]
    ) -> list[Finding]:
        """Return the findings with the rails among them, before weaker effects."""
        mine = Finding(first, rails)
        if findings and findings[0].judged.gain > rails.gain:
            return [findings[0], mine, *findings[1:]]
        return [mine, *findings]

    # --- the report -----------------------------------------------------------------------------

    def _report(
        self,
        verdict: str,
        first: Examination,
        finding: Finding | None,
        others: tuple[Finding, ...],
    ) -> Diagnosis:
        """Return the diagnosis in words and numbers."""
        missing = verdict == "missing" and finding is not None
        alike = self.list_lookalikes(finding) if missing and finding is not None else []
        nearest = finding.judged if finding else (first.judged[0] if first.judged else None)
        after = before = first.floor_ratio
        if missing and finding is not None:
            after = finding.judged.floor_ratio if not others else self._alone(first, finding)
        remainder = self._describe(first) if verdict == "unknown" else ()
        return Diagnosis(
            verdict=verdict,
            effect=finding.judged.kind if missing and finding is not None else None,
            parameters=self._refit(finding.judged) if missing and finding is not None else {},
            lookalikes=tuple(judged.kind for judged in alike),
            also=tuple(other.judged.kind for other in others) if missing else (),
            nearest=nearest.kind if verdict == "unknown" and nearest is not None else None,
            candidates=tuple(
                CandidateReport(
                    judged.kind,
                    judged.rmse_ratio,
                    judged.p_value,
                    judged.excitation,
                    judged.parameters,
                )
                for judged in first.judged
            ),
            not_testable=self._list_untested(first),
            floor_ratio_before=before,
            floor_ratio_after=after,
            floor_source="dwell" if self.dataset.dwell else "estimated",
            remainder=remainder,
            next_experiment=self._advise(verdict, first, finding, alike),
            evidence=self._weigh_evidence(),
            notes=self._list_notes(verdict, first),
        )

    def _refit(self, judged: Judged) -> dict[str, float]:
        """Return the effect's values by plain least squares, as the fit of the model gives them."""
        found = search(self.campaign, judged.found.terms, flat_weights(self.campaign), vary=())
        terms = tidy_terms(found.terms)
        values = next(term.values for term in terms if term.effect.kind == judged.kind)
        return {name: values[name] for name in judged.parameters}

    def _alone(self, first: Examination, finding: Finding) -> float:
        """Return the floor ratio with this one of several effects added."""
        for judged in first.judged:
            if judged.kind == finding.judged.kind:
                return judged.floor_ratio
        return finding.judged.floor_ratio

    def _list_untested(self, first: Examination) -> tuple[Untested, ...]:
        """Return the effects that could not be tested, those without rails included."""
        untested = list(first.untested)
        for kind, effect in self.catalogue.items():
            if effect.sets_aside and not any(t.effect.kind == kind for t in self.terms):
                why = explain_missing(effect, self.plan)
                if why:
                    untested.append(Untested(kind, why))
        return tuple(untested)

    def _describe(self, first: Examination) -> tuple[Pattern, ...]:
        """Return what the remainder of the model as it is follows."""
        rests = [
            run.drift - predict(first.base, run, self.plan, self.campaign.order)
            for run in self.dataset.train
        ]
        return tuple(describe_remainder(self.dataset.train, rests, self.plan, first.floor))

    def _advise(
        self,
        verdict: str,
        first: Examination,
        finding: Finding | None,
        alike: Sequence[Judged],
    ) -> str:
        """Return the next experiment."""
        if verdict == "missing" and finding is not None:
            if alike:
                return self._separate(finding, alike[0])
            effect = self.catalogue[finding.judged.kind]
            return f"to see {effect.kind} at its clearest: {_lower(effect.provoke)}"
        silent = [u for u in self._list_untested(first) if u.why.startswith("no input")]
        if verdict == "unknown":
            if silent:
                inputs = ", ".join(sorted({u.effect for u in silent}))
                return f"log what could not be tested here ({inputs}), and diagnose again"
            return (
                "repeat one run exactly: what comes back is an effect of temperature, load or "
                "time that the catalogue lacks, what does not is noise or a fault"
            )
        for untested in first.untested:
            effect = self.catalogue[untested.effect]
            return f"nothing is missing; to test {effect.kind} too: {_lower(effect.provoke)}"
        return "nothing is missing in these logs"

    def _separate(self, finding: Finding, rival: Judged) -> str:
        """Return the experiment that tells a finding from its look-alike."""
        leading = finding.judged
        if self.catalogue[leading.kind].sets_aside or self.catalogue[rival.kind].sets_aside:
            return _lower(self.catalogue[leading.kind].provoke)
        chosen = choose_experiment(
            self.plan,
            self.dataset.train,
            self.campaign.order,
            (leading.found.terms, leading.found.solution),
            (rival.found.terms, rival.found.solution),
            finding.examination.floor,
        )
        if chosen is None:
            return (
                "no simple experiment within the logs' temperatures and loads tells "
                f"{leading.kind} from {rival.kind}; {_lower(self.catalogue[leading.kind].provoke)}"
            )
        experiment, apart = chosen
        return (
            f"{experiment.instruction}: {leading.kind} and {rival.kind} would then differ by "
            f"{apart:.1f} times the noise"
        )

    def _weigh_evidence(self) -> str:
        """Return how many runs spoke, and whether that is thin."""
        runs = len(self.campaign.groups)
        if runs < FEWEST_RUNS:
            pieces = self.campaign.run_of_piece.size
            noun = "run was" if runs == 1 else "runs were"
            return (
                f"thin: {runs} {noun} cut into {pieces} pieces, which resemble each other more "
                f"than runs would; p-values are too small. {WANTED_RUNS} runs or more are wanted"
            )
        if runs < ENOUGH_RUNS:
            return (
                f"thin: with {runs} runs no p-value can be below {2.0**-runs:.2g}; "
                f"{WANTED_RUNS} runs or more are wanted"
            )
        return f"{runs} runs"

    def _list_notes(self, verdict: str, first: Examination) -> tuple[str, ...]:
        """Return what else a reader should know."""
        notes = []
        if not self.dataset.dwell:
            notes.append(
                "there is no dwell in [logs], so the noise floor is estimated from the fast part "
                "of what the model leaves, and slow noise cannot be told from a missing effect"
            )
        elif self.wanders(first):
            notes.append(
                "the sensor wanders slowly even in the dwell, at rest: that part is no effect of "
                "temperature or load"
            )
        if verdict == "complete" and first.judged and self.campaign.pieces_per_run > 1:
            notes.append("one run cannot show what differs from run to run")
        return tuple(notes)


def _without(terms: Sequence[Term], kind: str, told: Mapping[str, Term]) -> tuple[Term, ...]:
    """Return the terms without an effect that was added, or with one as the user told it."""
    kept = [told.get(kind, term) if term.effect.kind == kind else term for term in terms]
    return tuple(term for term in kept if term.effect.kind != kind or kind in told)


def _lower(sentence: str) -> str:
    """Return a sentence to go on with after a colon."""
    return sentence[:1].lower() + sentence[1:].rstrip(".")
