"""What a model of the drift can learn from the logs, and which protocol to record next.

Three questions, each answered by a measurement on the training runs: how long the drift remembers
the temperature and whether the network's memory spans that; whether the runs were heated in more
than one way; and what the programme never did. `docs/how-to/record-logs.md` has examples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.heat_paths import (
    EXCITED_K,
    ONE_WAY,
    Path,
    Programme,
    compare_paths,
    describe_programme,
    measure_untold,
)
from zerodrift.diagnosis.memory import MemoryTable, TimeConstant, find_time_constants
from zerodrift.diagnosis.network_memory import Memory, judge_memory, list_windows
from zerodrift.diagnosis.summary import (
    AdviceSummary,
    MemorySummary,
    ProtocolSummary,
    TimeConstantSummary,
)
from zerodrift.diagnosis.thermometers import list_thermometers
from zerodrift.physics.live import find_live

SLOW_SHARE = 0.05
"""A lag longer than this share of the longest run differs from run to run by chance."""
NARROW_K = 30.0
"""A programme over fewer kelvin teaches little about curvature."""
MOST_NAMED = 4


@dataclass(frozen=True)
class Advice:
    """What can and cannot be learnt from these logs."""

    time_constants: tuple[TimeConstant, ...]
    without_memory: float
    """Held-out error without memory over that with the lags found."""
    memory: Memory
    heat: str
    """several | perhaps | one | unknown: whether heat came in more ways than one."""
    paths: tuple[Path, ...]
    programme: Programme
    untold_K: dict[str, float]
    """Further thermometer -> RMS in K of its part that the chip's temperature history does not
    explain."""
    thermometers: tuple[str, ...]
    protocols: tuple[ProtocolSummary, ...]
    """What to record next, the most wanted first; empty: nothing more."""

    @property
    def spans(self) -> bool | None:
        """Whether the memory spans the time constants; None where there are none."""
        return self.memory.spans if self.time_constants else None

    def summarise(self) -> AdviceSummary:
        """Return the advice as the commands print it."""
        memory = self.memory
        return AdviceSummary(
            time_constants=tuple(
                TimeConstantSummary(t.tau_s, t.low_s, t.high_s, t.determined)
                for t in self.time_constants
            ),
            rmse_ratio_without_memory=self.without_memory,
            memory=MemorySummary(
                name=memory.name,
                span_s=memory.span_s,
                rmse_ratio=memory.error_ratio,
                rmse_ratio_of_window_alone=memory.window_ratio,
                spans=self.spans,
            ),
            heat_paths=self.heat,
            runs={path.run: path.ratio for path in self.paths},
            untold_K=self.untold_K,
            next_protocols=self.protocols,
            sentences=tuple(self.explain()),
        )

    def explain(self) -> list[str]:
        """Return the advice in sentences."""
        return [*self.explain_memory(), *_explain_heat(self), *self.explain_next()]

    def explain_next(self) -> list[str]:
        """Return what to record next, in a sentence."""
        if not self.protocols:
            return [
                "Record next: nothing that these logs call for; logs of the sensor at work, kept "
                "for [logs] test, would show what is left."
            ]
        first = self.protocols[0]
        others = ", ".join(protocol.name for protocol in self.protocols[1:])
        sentence = f"Record next: {first.name}. {first.instruction}, because {first.why}."
        return [sentence + (f" Then: {others}." if others else "")]

    def explain_memory(self) -> list[str]:
        """Return what the drift remembers, and whether the network can."""
        if not self.time_constants:
            return [
                "Memory: the drift follows the thermometer without a lag that these logs show, so "
                "they call for no memory."
            ]
        lags = " and ".join(
            f"{_write(t.tau_s)} s ({_write(t.low_s)} to {_write(t.high_s)} s"
            f"{', the longest these runs can show' if t.at_limit else ''})"
            for t in sorted(self.time_constants, key=lambda t: t.tau_s)
        )
        first = (
            f"Memory: the drift lags the thermometer by {lags}. Without memory, runs left out are "
            f"predicted {self.without_memory:.2g} times worse."
        )
        return [first, *self.memory.explain()]


def _write(seconds: float) -> str:
    """Return a time with two digits."""
    return f"{float(f'{seconds:.2g}'):g}"


def advise(
    config: Config, dataset: Dataset, effects: Sequence[EffectConfig] | None = None
) -> Advice | None:
    """Return what the training runs can teach.

    Args:
        config: the project; its network is what is advised on.
        dataset: its runs.
        effects: the model's effects, where they are not those of the file.

    Returns:
        None where no output moves, so that there is nothing to learn.
    """
    runs = dataset.train
    if not runs or not find_live(runs).any():
        return None
    thermometers = tuple(
        name for name in list_thermometers(config) if all(name in run.inputs for run in runs)
    )
    network = config.network
    windows = list_windows(network, runs[0].sample_period_s)
    table = MemoryTable(runs, thermometers=thermometers, windows=windows, lags_s=network.lags_s)
    found = find_time_constants(table)
    taus_s = [t.tau_s for t in found]
    best = table.rmse(table.lags(taus_s)) if taus_s else table.rmse([])
    kinds = [effect.kind for effect in (config.effects if effects is None else effects)]
    memory = judge_memory(table, network, kinds, taus_s)
    paths = compare_paths(table, taus_s)
    programme = describe_programme(runs)
    untold_k = {name: measure_untold(table, name) for name in thermometers}
    excited = any(kelvin > EXCITED_K for kelvin in untold_k.values())
    slow = any(t.tau_s > SLOW_SHARE * programme.longest_s for t in found)
    heat = _judge_heat(paths, excited, slow)
    return Advice(
        time_constants=found,
        without_memory=table.rmse([]) / best if best > 0.0 else 1.0,
        memory=memory,
        heat=heat,
        paths=paths,
        programme=programme,
        untold_K=untold_k,
        thermometers=thermometers,
        protocols=tuple(_list_protocols(runs, programme, found, heat, thermometers)),
    )


def _judge_heat(paths: Sequence[Path], excited: bool, slow: bool) -> str:
    """Return in how many ways heat came.

    Args:
        paths: the run that fits worst first.
        excited: a further thermometer was reached by heat of its own.
        slow: the drift has a lag that runs as long as these tell badly.
    """
    if excited or (paths and paths[0].differs and not slow):
        return "several"
    if not paths:
        return "unknown"
    return "one" if paths[0].ratio < ONE_WAY else "perhaps"


def _explain_heat(advice: Advice) -> list[str]:
    """Return in which ways the sensor was heated."""
    sentences = []
    differing = [path.run for path in advice.paths if path.differs]
    if advice.heat == "unknown":
        return ["Heat paths: one run alone cannot show whether another way of heating differs."]
    worst = advice.paths[0] if advice.paths else None
    if advice.heat == "one" and worst is not None:
        sentences.append(
            "Heat paths: the logs show one. The lag of every run is predicted by the others (worst "
            f"in {worst.run}, at {worst.ratio:.2f} times the error of lags of its own). What heat "
            "from one side does is not verified by them."
        )
    elif advice.heat == "perhaps" and worst is not None:
        sentences.append(
            "Heat paths: perhaps more than one. The lags that the other runs teach leave "
            f"{worst.ratio:.2f} times what lags of its own leave of {worst.run}: it was heated "
            "another way, or the runs tell a slow lag badly."
        )
    elif differing and worst is not None:
        named = ", ".join(differing[:MOST_NAMED]) + (
            f" and {len(differing) - MOST_NAMED} more" if len(differing) > MOST_NAMED else ""
        )
        sentences.append(
            f"Heat paths: more than one. The lags that the other runs teach fail for {named} (up "
            f"to {worst.ratio:.2g} times the error of lags of a run's own)."
        )
        if not advice.thermometers:
            sentences.append(
                "One thermometer does not distinguish the paths; a second one on the elastic body, "
                "as an input, would."
            )
    else:
        names = " and ".join(advice.thermometers)
        sentences.append(f"Heat paths: more than one, and {names} distinguishes them.")
    for name, kelvin in advice.untold_K.items():
        told = "" if kelvin > EXCITED_K else ", so no heat reached it by a way of its own"
        sentences.append(
            f"{name} moves by {kelvin:.2g} K RMS beyond what the chip's history tells{told}."
        )
    return sentences


def _list_protocols(
    runs: Sequence[Run],
    programme: Programme,
    found: Sequence[TimeConstant],
    heat: str,
    thermometers: Sequence[str],
) -> list[ProtocolSummary]:
    """Return what the logs lack, the most wanted first."""
    wanted = []
    if programme.hottest_degC - programme.coldest_degC < NARROW_K:
        wanted.append(
            ProtocolSummary(
                "the whole range",
                "Cycle the air over all temperatures of the sensor's use, with dwells at both ends",
                f"the logs cover {programme.coldest_degC:.0f} to {programme.hottest_degC:.0f} degC",
            )
        )
    if heat == "unknown":
        wanted.append(
            ProtocolSummary(
                "more runs",
                "Record at least three runs, each with rates and dwells of its own",
                "with one run nothing can be left out to judge by",
            )
        )
    if heat in ("one", "perhaps"):
        wanted.append(
            ProtocolSummary(
                "heat from one side",
                "Heat one side alone, cool it alone, and heat the side opposite, in steps of 5 to "
                "15 min, from several starting temperatures, four runs or more",
                "these logs do not show what heat from one side does, which a sensor meets at work",
            )
        )
    if heat == "several" and not thermometers:
        wanted.append(
            ProtocolSummary(
                "a second thermometer",
                "Log a thermometer on the elastic body beside the chip's, as a column under "
                "[inputs], and repeat a chamber cycle and a one-sided run",
                "the chip's history does not show one way of heating from another",
            )
        )
    slowest = max((t.tau_s for t in found), default=0.0)
    if not programme.varied:
        wanted.append(
            ProtocolSummary(
                "two ramp rates",
                "Ramp the air once fast and once at a third of that rate, up and down, with dwells "
                f"of {max(5.0 * slowest, 600.0) / 60.0:.0f} min",
                "all ramps have nearly one rate, and a lag, a gradient and a hysteresis then look "
                "alike",
            )
        )
    elif any(t.at_limit for t in found):
        wanted.append(
            ProtocolSummary(
                "long dwells",
                f"Step the air once and wait {5.0 * slowest / 60.0:.0f} min or more",
                f"the slowest lag is longer than runs of {programme.longest_s / 60.0:.0f} min show",
            )
        )
    if all(not (run.reference.max(axis=0) > run.reference.min(axis=0)).any() for run in runs):
        wanted.append(
            ProtocolSummary(
                "known loads at several temperatures",
                "Put known loads on and off while the air ramps, their values in the reference "
                "columns",
                "no run has a load, so the gain over temperature is not verified",
            )
        )
    if not programme.power_ons:
        wanted.append(
            ProtocolSummary(
                "cold power-on",
                "Switch on after hours off, at rest, and log from the first second without taring",
                "no log begins with the power-on, so self-heating is not in them",
            )
        )
    return wanted
