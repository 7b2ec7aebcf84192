"""What a model of the drift can learn from the logs, and which protocol to record next.

Three questions, each answered by a measurement on the training runs: how long the drift remembers
the temperature and whether the network's memory spans that; whether the runs were heated in more
than one way; and what the programme never did. `docs/how-to/record-logs.md` has examples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import (
    RECURRENT_KINDS,
    WINDOW,
    WINDOWED_KINDS,
    Config,
    EffectConfig,
    NetworkConfig,
)
from zerodrift.dataset.runs import Dataset, Run
from zerodrift.diagnosis.drivers import list_thermometers
from zerodrift.diagnosis.memory import MemoryTable, TimeConstant, find_time_constants
from zerodrift.diagnosis.summary import (
    AdviceSummary,
    MemorySummary,
    ProtocolSummary,
    TimeConstantSummary,
)
from zerodrift.physics.live import find_live

# Whether all runs were heated the same way, as far as thermometer and drift show.
#
# A sensor that is heated from all sides warms its body, its elements and the board with its
# thermometer in one order; from one side, by a warm sole or a lamp, in another. A model of the
# thermometer's history holds for the way it learnt. Where a run's lag, predicted from the other
# runs, is wrong, and the same lag with coefficients of the run's own is right, that run was heated
# another way.

ANOTHER_WAY = 1.8
"""A run was heated another way if the others' lags leave this many times what its own leave."""
ONE_WAY = 1.35
"""Below this it was heated the same way. Between the two a slow lag, which a few runs tell badly,
and a second way of heating look alike."""
EXCITED_K = 0.05
"""A further thermometer that moves by more than this beyond the chip's history, kelvin RMS, was
reached by heat of another way; well above a thermometer's noise of a few thousandths."""
RATE_WINDOW_S = 60.0
"""Rates of temperature are taken over this time."""
MOVING = 0.1
"""Share of the fastest rate above which the temperature moves."""
VARIED = 2.0
"""Rates are varied if the 90th percentile of their sizes is this many times the 25th."""
POWER_ON_S = 1.0
"""A log that begins no later than this, or than one sample, begins with the power-on."""


@dataclass(frozen=True)
class Path:
    """How well the lags of the other runs predict one run's drift."""

    run: str
    ratio: float
    """RMSE by the others' lags over that by the same lags with the run's own coefficients."""

    @property
    def differs(self) -> bool:
        """Whether it was heated another way."""
        return self.ratio >= ANOTHER_WAY


@dataclass(frozen=True)
class Programme:
    """What the temperature does in the logs."""

    coldest_degC: float
    hottest_degC: float
    varied: bool
    """Whether fast and slow ramps are both there."""
    longest_s: float
    power_ons: int
    """Logs that begin with the power-on."""


def compare_paths(table: MemoryTable, taus_s: Sequence[float]) -> tuple[Path, ...]:
    """Return how each run fits the others, the one that fits worst first.

    Where no lag helps all runs, since each has its own, two lags a decade apart stand for them.
    One run has nothing to be compared with: the result is empty.
    """
    if len(table.groups) < 2:
        return ()
    third = len(table.grid) // 3
    taus_s = sorted({*taus_s, table.grid[third], table.grid[2 * third]})
    base, lags = table.take_base(), table.lags(taus_s)
    index = [*base, *lags]
    # The lags' linear parts, which a run is long enough to tell.
    own_lags = [len(base) + 3 * i for i in range(len(taus_s))]
    total = table.products.sum(axis=0)
    wide = table.products.shape[1] - len(table.outputs)
    found = []
    for g, group in enumerate(table.groups):
        rest = (total - table.products[g])[None]
        solution = table.solve(rest[:, index][:, :, index], rest[:, index, wide:])[0]
        own = table.products[g][np.ix_(index, index)]
        target = table.products[g][index, wide:]
        power = np.diag(table.products[g][wide:, wide:])
        theirs = _measure(solution, own, target, power)
        # What the others' model leaves, with the lags' coefficients free for this run.
        left = target - own @ solution
        step = table.solve(own[np.ix_(own_lags, own_lags)][None], left[own_lags][None])[0]
        changed = solution.copy()
        changed[own_lags] += step
        ours = _measure(changed, own, target, power)
        ratio = float(np.sqrt(np.mean(theirs / np.maximum(ours, 1e-300))))
        found.append(Path(group, ratio))
    return tuple(sorted(found, key=lambda path: -path.ratio))


def _measure(solution: Array, own: Array, target: Array, power: Array) -> Array:
    """Return the squares [K] that a solution leaves."""
    cross = np.einsum("jk,jk->k", solution, target)
    return np.asarray(
        np.maximum(power - 2.0 * cross + np.einsum("jk,jk->k", solution, own @ solution), 0.0)
    )


def measure_untold(table: MemoryTable, thermometer: str) -> float:
    """Return the RMS in K of a further thermometer that the chip's history does not explain.

    The further thermometer's distance from the chip is fitted, over all runs, by lags of the
    chip's temperature over the whole grid; what remains moved by itself, so heat reached it by
    another way.
    """
    parts = []
    for run in table.runs:
        own = np.stack(table.list_lagged(run), axis=1)
        distance = run.inputs[thermometer] - run.temperature_degC
        rows = np.concatenate([own, distance[:, None]], axis=1)
        parts.append(rows - rows.mean(axis=0))
    rows = np.concatenate(parts)
    coefficients = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=1e-6)[0]
    return float(np.std(rows[:, -1] - rows[:, :-1] @ coefficients))


def describe_programme(runs: Sequence[Run]) -> Programme:
    """Return what the temperature does in the logs."""
    dt_s = runs[0].sample_period_s
    window = max(1, round(RATE_WINDOW_S / dt_s))
    rates = [
        (run.temperature_degC[window:] - run.temperature_degC[:-window]) / (window * dt_s) * 60.0
        for run in runs
        if len(run) > window
    ]
    rate = np.concatenate(rates) if rates else np.zeros(1)
    fastest = float(np.percentile(np.abs(rate), 99.0))
    size = np.abs(rate)
    size = size[size >= MOVING * fastest]
    low, high = np.percentile(size, [25.0, 90.0]) if size.size else (1.0, 1.0)
    starts = {
        run.group: run.time_s[0] if run.start_s is None else run.start_s
        for run in reversed(runs)
        if run.part == 0
    }
    return Programme(
        coldest_degC=min(float(run.temperature_degC.min()) for run in runs),
        hottest_degC=max(float(run.temperature_degC.max()) for run in runs),
        varied=bool(high >= VARIED * low),
        longest_s=max(len(run) for run in runs) * dt_s,
        power_ons=sum(bool(0.0 <= x <= max(POWER_ON_S, dt_s)) for x in starts.values()),
    )


# Whether what a network is shown reaches as far back as the drift remembers.

SPANS = 1.1
"""A memory spans the time constants if it leaves no more than this many times their error."""
SPACINGS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
"""Distances of a window's samples that are tried, in sample periods."""
SPACING_S = 10.0
"""Of a window that names none, for the kinds that are nothing without one."""
LAG_EFFECTS = ("thermal_lag", "thermal_gradient")
STREAM = 'memory = "stream"'


@dataclass(frozen=True)
class Memory:
    """What the network or the model remembers, beside what the drift does."""

    name: str
    """In words, such as `the window of 10 samples 1 s apart`."""
    span_s: float | None
    """From its oldest sample to now, lags aside; None: no fixed length."""
    error_ratio: float | None
    """Held-out error of a linear model over all that it sees, over that of the lags found; None:
    it is found from the logs, or trained, and so not told before."""
    window_ratio: float | None = None
    """The same of the window alone."""
    remedy: str = ""
    aside: str = ""
    """What else belongs to it, in a sentence."""

    @property
    def spans(self) -> bool:
        """Whether it reaches as far back as the drift remembers."""
        return self.error_ratio is None or self.error_ratio <= SPANS

    def explain(self) -> list[str]:
        """Return what it spans, in sentences."""
        name = self.name[:1].upper() + self.name[1:]
        if self.window_ratio is not None and self.window_ratio > SPANS and self.spans:
            return [
                f"{name} alone does not span that (a linear model over it leaves "
                f"{self.window_ratio:.2f} times the error of those lags). {self.aside}"
            ]
        if self.span_s == 0.0 and self.error_ratio is not None and not self.spans:
            return [
                f"{name} has no memory, which leaves {self.error_ratio:.2f} times the error of "
                f"those lags. {self.remedy}"
            ]
        if self.error_ratio is None:
            return [f"{name} has no fixed length, so it can span that."]
        verdict = "spans that" if self.spans else "does not span that"
        remedy = "" if self.spans or not self.remedy else f" {self.remedy}"
        return [
            f"{name} {verdict}: a linear model over it leaves {self.error_ratio:.2f} times the "
            f"error of those lags.{remedy}"
        ]


def read_window(network: NetworkConfig, dt_s: float) -> tuple[int, float] | None:
    """Return samples and spacing of the network's window; None where it has none."""
    if network.kind in WINDOWED_KINDS:
        samples = WINDOW if isinstance(network.memory, str) else network.memory
        spacing_s = float(network.options.get("spacing_s", SPACING_S))
        return samples, max(1, round(spacing_s / dt_s)) * dt_s
    if network.kind in RECURRENT_KINDS and not isinstance(network.memory, str):
        return network.memory, dt_s
    return None


def list_windows(network: NetworkConfig, dt_s: float) -> list[tuple[int, float]]:
    """Return the network's window and others of as many samples, which may do better."""
    window = read_window(network, dt_s)
    if window is None:
        return []
    return list(dict.fromkeys([window, *((window[0], spacing * dt_s) for spacing in SPACINGS)]))


def judge_memory(
    table: MemoryTable, network: NetworkConfig, effects: Sequence[str], taus_s: Sequence[float]
) -> Memory:
    """Return how far back the network sees, beside the lags that were found.

    Args:
        table: with the windows of `list_windows` and the network's own lags.
        network: the `[network]` table.
        effects: kinds of the model's effects.
        taus_s: the lags that the logs call for.
    """
    best = table.rmse(table.lags(taus_s))
    window = read_window(network, table.sample_period_s)
    if network.kind == "none":
        if set(effects) & set(LAG_EFFECTS):
            return Memory("the model's thermal lag", None, None)
        remedy = "`zerodrift diagnose` tries thermal_lag; a network remembers too."
        return Memory("a model without thermal lag", 0.0, table.rmse([]) / best, None, remedy)
    own = table.lags(network.lags_s) if network.lags_s else []
    if window is None:
        if not network.lags_s or network.kind in RECURRENT_KINDS:
            return Memory("the network's memory", None, None)
        remedy = "Leave lags_s out, and training finds lags of its own."
        name = f"the bank of {_write_lags(network.lags_s)}"
        return Memory(name, max(network.lags_s), table.rmse(own) / best, None, remedy)
    samples, spacing_s = window
    columns = table.window(samples, spacing_s)
    span_s = (samples - 1) * spacing_s
    name = f"the window of {samples} samples {spacing_s:g} s apart, {span_s:g} s long,"
    alone = table.rmse(columns) / best
    if network.lags_s:
        ratio = table.rmse([*columns, *own]) / best
        aside = f"With {_write_lags(network.lags_s)} it does."
        return Memory(name, span_s, ratio, alone, _find_remedy(table, network, best), aside)
    aside = "The lags that training finds in the logs, and shows to the network too, do."
    return Memory(name, span_s, min(alone, 1.0), alone, "", aside)


def _write_lags(lags_s: Sequence[float]) -> str:
    return f"lags of {', '.join(f'{tau:g}' for tau in lags_s)} s"


def _find_remedy(table: MemoryTable, network: NetworkConfig, best: float) -> str:
    """Return what to have instead of a window that is too short."""
    ways = ["Leave lags_s out, and training finds lags of its own."]
    if network.kind in RECURRENT_KINDS:
        ways.append(f"{STREAM} has no fixed length.")
    else:
        windows = list_windows(network, table.sample_period_s)[1:]
        enough = [w for w in windows if table.rmse(table.window(*w)) <= SPANS * best]
        ways += [f"{n} samples {spacing_s:g} s apart would span it." for n, spacing_s in enough[:1]]
    return " ".join(ways)


# What a model of the drift can learn from the logs, and which protocol to record next.

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
