"""The way from logs to a report: what is done, and the one next step with its reason."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from zerodrift.diagnosis.diagnosis import WEAK, ExplainedDiagnosis, rate_strength
from zerodrift.report.findings import Findings

DONE, NEXT, LATER, BUSY = "done", "next", "later", "busy"
TITLES = {
    "compare": "Compare",
    "diagnose": "Diagnose",
    "add": "Add what is missing",
    "firmware": "Firmware",
    "verify": "Verify",
    "apply": "Apply",
    "report": "Report",
}
"""Step -> its name; training is the first part of building firmware."""
RUNS = {
    "compare": "compare",
    "look": "diagnose",
    "add": "add",
    "remove": "add",
    "propose": "add",
    "plan": "diagnose",
    "train": "firmware",
    "firmware": "firmware",
    "verify": "verify",
    "apply": "apply",
    "report": "report",
}
"""Job -> the step that it is part of."""


@dataclass(frozen=True)
class ProjectStanding:
    """What is known of a project, as far as the way goes."""

    findings: Findings | None
    job: str = ""
    """What runs; empty: nothing."""
    refused: Mapping[str, str] = field(default_factory=dict)
    """Effect -> why `add` refused it on these logs and this model."""
    proposed: bool = False
    """Whether a formula was looked for."""
    planned: bool = False
    """Whether the next experiment was planned."""
    verified: bool = False
    applied: bool = False
    reported: bool = False


@dataclass(frozen=True)
class Offer:
    """Something to press."""

    button: str
    words: str
    effect: str = ""
    """For `add`."""


@dataclass(frozen=True)
class PathStep:
    """One step of the way."""

    name: str
    state: str
    """done | next | later | busy."""
    found: str = ""
    """What it found, in a few words."""

    @property
    def title(self) -> str:
        """Its name, for people."""
        return TITLES[self.name]


@dataclass(frozen=True)
class ProjectWay:
    """The way, and what to do now."""

    steps: tuple[PathStep, ...]
    offer: Offer | None
    """The one thing that is proposed; None while something runs or nothing can be done."""
    reason: str
    """Why that, in a sentence."""
    others: tuple[Offer, ...] = ()
    """What may be done as well."""
    weak: str = ""
    """What makes the evidence weak; empty where it is not, or nothing is named."""


def find_path(standing: ProjectStanding) -> ProjectWay:
    """Return what is done, and the next step with its reason."""
    findings = standing.findings
    if findings is None:
        # A look compares first; that it diagnoses then is said once it does.
        busy = replace(standing, job="compare" if standing.job == "look" else standing.job)
        return ProjectWay(_list_steps("compare", busy, {}), None, "The logs are being read.")
    explained = findings.diagnosed
    found = _tell_found(findings, standing)
    if explained is None:
        reason = "What the model lacks is not known yet."
        offer = None if standing.job else Offer("look", "Diagnose")
        return ProjectWay(_list_steps("diagnose", standing, found), offer, reason)
    strength = rate_strength(explained.diagnosis)
    step, offer, reason, others = _choose(findings, explained, standing, strength.level == WEAK)
    if standing.job:
        offer = None
    weak = strength.why if strength.level == WEAK else ""
    return ProjectWay(_list_steps(step, standing, found), offer, reason, others, weak)


def _list_steps(
    now: str, standing: ProjectStanding, found: Mapping[str, str]
) -> tuple[PathStep, ...]:
    names = list(TITLES)
    busy = RUNS.get(standing.job, "")
    place = names.index(now) if now in names else len(names)
    steps = []
    for number, name in enumerate(names):
        state = DONE if number < place else NEXT if number == place else LATER
        if name in ("verify", "apply") and number < place and name not in found:
            state = LATER
        steps.append(PathStep(name, BUSY if name == busy else state, found.get(name, "")))
    return tuple(steps)


def _tell_found(findings: Findings, standing: ProjectStanding) -> dict[str, str]:
    """Return what each step found, in a few words."""
    outputs, runs = findings.comparison.outputs, len(findings.traces)
    found = {"compare": f"{runs} run{'s' if runs != 1 else ''}, {len(outputs)} outputs"}
    explained = findings.diagnosed
    if explained is not None:
        told = {"missing": explained.diagnosis.effect or "", "complete": "nothing is missing"}
        found["diagnose"] = told.get(explained.diagnosis.verdict, "unknown to the catalogue")
    effects = findings.comparison.effects
    found["add"] = ", ".join(effects) or "no effect"
    firmware = findings.firmware
    if firmware is not None:
        found["firmware"] = f"{firmware.flash_bytes} B of flash"
    if standing.verified:
        found["verify"] = "bits equal"
    if standing.applied:
        found["apply"] = "done"
    if standing.reported:
        found["report"] = "report.html"
    return found


Chosen = tuple[str, Offer | None, str, tuple[Offer, ...]]


def _choose(
    findings: Findings, explained: ExplainedDiagnosis, standing: ProjectStanding, weak: bool
) -> Chosen:
    """Return the next step, what to press for it, why, and what else there is."""
    diagnosis = explained.diagnosis
    open_names = [name for name in explained.named if name not in standing.refused]
    adds = [Offer("add", f"Add {name}", name) for name in open_names]
    firmware = Offer("firmware", "Train and build firmware")
    plan = () if standing.planned else (Offer("plan", "Plan the next experiment"),)
    if diagnosis.verdict == "missing" and adds and not weak:
        gain = (
            f"With it the error on runs left out falls from {diagnosis.floor_ratio_before:.2f} to "
            f"{diagnosis.floor_ratio_after:.2f} times the noise floor."
        )
        alike = [Offer("add", f"Add look-alike {o.effect}", o.effect) for o in adds[1:]]
        return "add", adds[0], gain, (*alike, *(plan if alike else ()), firmware)
    others: list[Offer] = []
    if weak and adds:
        others = [Offer("add", f"Add {adds[0].effect} all the same", adds[0].effect), *plan]
    for other in explained.thermometers[:1]:
        kind = other.command.kind
        offer = Offer("add", f"Add {kind} after {other.signal}", kind)
        if kind not in standing.refused and diagnosis.verdict != "missing":
            return "add", offer, f"The drift follows {other.signal}: {other.reason}.", (firmware,)
    propose = Offer("propose", "Look for a formula")
    if diagnosis.verdict == "unknown" and diagnosis.wrong_runs and findings.firmware is None:
        runs = diagnosis.tell_wrong_runs()
        reason = f"The data of {runs} look wrong, as is said above: mend them or leave them out."
        return "diagnose", Offer("look", "Look again"), reason, (propose, *plan, firmware)
    if diagnosis.verdict == "unknown" and not standing.proposed and findings.firmware is None:
        reason = (
            "No effect of the catalogue explains what is left "
            f"({diagnosis.floor_ratio_before:.2f} times the noise floor)."
        )
        return "add", propose, reason, (*plan, firmware)
    if diagnosis.verdict == "unknown":
        others += [propose, *plan]
    if findings.firmware is not None:
        return _choose_after_firmware(standing, tuple(others))
    why = _tell_why_firmware(explained, standing, weak)
    return "firmware", firmware, why, tuple(others)


def _tell_why_firmware(explained: ExplainedDiagnosis, standing: ProjectStanding, weak: bool) -> str:
    diagnosis = explained.diagnosis
    refused = [name for name in explained.named if name in standing.refused]
    if refused:
        return (
            f"{refused[0]} was refused: {standing.refused[refused[0]]}. The model stays as it is."
        )
    if weak:
        return (
            f"{diagnosis.effect} may be missing, but the evidence is weak; the model can be built "
            "as it is. More runs would show."
        )
    ratio = f"{diagnosis.floor_ratio_before:.2f} times the noise floor"
    if diagnosis.verdict == "complete":
        return f"Nothing is missing that these logs can show; runs left out are at {ratio}."
    return f"A network learns what no effect explains; runs left out are at {ratio}."


def _choose_after_firmware(standing: ProjectStanding, others: tuple[Offer, ...]) -> Chosen:
    again = Offer("firmware", "Build again")
    if not standing.verified:
        reason = "The firmware is built; Verify runs what lies in its folder on every back end."
        return "verify", Offer("verify", "Verify the firmware"), reason, (again, *others)
    apply = Offer("apply", "Apply it to the test logs")
    if not standing.reported:
        reason = "The firmware's bits are equal on every back end; the report says all of it."
        return "report", Offer("report", "Write the report"), reason, (apply, again, *others)
    reason = "All is done: firmware and report can be sent."
    more = (Offer("report", "Write the report again"), apply, again, *others)
    return "sent", Offer("download", "Download the firmware"), reason, more
