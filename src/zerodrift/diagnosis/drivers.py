"""What a drift may follow: a channel, its rate or its lag; and which of them an effect suspects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import Config, EffectConfig
from zerodrift.dataset.runs import Dataset
from zerodrift.dataset.units import read_unit
from zerodrift.diagnosis.changes import AddCommand, name_effect, propose_forms
from zerodrift.diagnosis.judgement import measure_overall
from zerodrift.diagnosis.revision import revise_best
from zerodrift.operations.lowpass import lowpass
from zerodrift.physics.catalogue import Catalogue

# Further thermometers: whether the drift that a model leaves follows one of them.

KIND = "zero_tempco"
"""The effect that is tried with each thermometer: of all that drifts with temperature the first."""


@dataclass(frozen=True)
class OtherThermometer:
    """An input that the drift follows, beside the chip's own thermometer."""

    signal: str
    """Its name in [inputs]."""
    rmse_left_out_ratio: float
    """RMSE on data held out, with `KIND` following it over that of the model as it is, geometric
    mean over the outputs."""
    reason: str
    """What it gains, in a sentence."""
    command: AddCommand
    """What adds it."""


def list_thermometers(config: Config) -> list[str]:
    """Return the inputs that are temperatures, by their name or by their column's unit."""
    return [
        name
        for name, column in config.inputs.items()
        if "temperature" in name or read_unit(column) in ("degC", "K")
    ]


def try_thermometers(
    config: Config, effects: Sequence[EffectConfig], dataset: Dataset, catalogue: Catalogue
) -> list[OtherThermometer]:
    """Return the thermometers that a zero shift follows with a held-out gain, the best first.

    Args:
        config: the project.
        effects: the model's effects, which need not be those of the file.
        dataset: its runs.
        catalogue: the known effects.
    """
    config = replace(config, effects=tuple(effects))
    present = {name_effect(effect) for effect in effects}
    found = []
    for signal in list_thermometers(config):
        wanted = EffectConfig(KIND, options={"signal": signal})
        if name_effect(wanted) in present or KIND not in catalogue:
            continue
        changes = propose_forms(config, dataset, catalogue, wanted)
        revision = revise_best(config, dataset, catalogue, changes)
        if revision.helps:
            command = AddCommand(KIND, ("--set", f"signal={signal}"))
            ratio = measure_overall(revision.before, revision.after)
            found.append(OtherThermometer(signal, ratio, revision.reason, command))
    return sorted(found, key=lambda one: one.rmse_left_out_ratio)


# What a drift may follow: a channel, its rate or its lag; and which of them an effect suspects.

VALUE, RATE, LAG = "value", "rate", "lag"
FORMS = (VALUE, RATE, LAG)
TEMPERATURE, TIME = "temperature", "time"
RATE_SPAN_S = 60.0
"""Time over which rates are taken, so that the thermometer's steps do not show."""
TAU_S = 60.0
"""Time constant of a lag where nothing says another."""
FORMS_OF_PARAMETERS = {"tau_s": LAG, "delay_s": RATE, "smoothing_s": RATE}
"""What an effect with such a parameter sees of its channel."""
LOADS = ("load", "saturated")
TIMES = ("elapsed", "clock")


@dataclass(frozen=True)
class DriftDriver:
    """A signal that a drift may follow."""

    channel: str
    """temperature | time | an input's name | `load NAME` of an output."""
    form: str = VALUE
    """value | rate | lag: the signal, its slope per minute, or the signal less its low-pass."""
    tau_s: float = TAU_S
    """Time constant of the low-pass; only a lag has one."""

    @property
    def key(self) -> str:
        """Itself as a text, from which `read_driver` makes it again."""
        return f"{self.form}:{self.tau_s:g}:{self.channel}"

    def describe(self) -> str:
        """Return it in words."""
        if self.form == RATE:
            return f"rate of {self.channel}"
        if self.form == LAG:
            return f"lag of {self.channel}, {self.tau_s:.3g} s"
        return self.channel

    def name_unit(self, unit: str) -> str:
        """Return its unit, given that of the channel."""
        difference = "K" if unit == "degC" else unit
        if self.form == RATE:
            return f"{difference}/min"
        return difference if self.form == LAG else unit


def read_driver(key: str) -> DriftDriver | None:
    """Return the driver of such a key; None where it is none."""
    form, _, rest = key.partition(":")
    tau, _, channel = rest.partition(":")
    try:
        tau_s = float(tau)
    except ValueError:
        return None
    if form not in FORMS or not channel or not 0.0 < tau_s < 1e9:
        return None
    return DriftDriver(channel, form, tau_s)


def find_stretches(time_s: Array, period_s: float) -> list[slice]:
    """Return the uninterrupted stretches [n] of a run's clock, which are laid end to end."""
    breaks = np.flatnonzero(np.abs(np.diff(time_s) - period_s) > 0.5 * period_s) + 1
    edges = [0, *breaks.tolist(), int(time_s.size)]
    return [slice(a, b) for a, b in pairwise(edges)]


def measure_slope(time_s: Array, values: Array, period_s: float) -> Array:
    """Return the slope [n] of a signal per minute, over a minute around each sample.

    Args:
        time_s: [n] of one uninterrupted stretch.
        values: [n].
        period_s: from sample to sample.
    """
    reach = min(max(1, round(0.5 * RATE_SPAN_S / period_s)), max(time_s.size - 1, 1))
    rows = np.arange(time_s.size)
    late = np.minimum(rows + reach, time_s.size - 1)
    early = np.maximum(rows - reach, 0)
    span_s = np.maximum(time_s[late] - time_s[early], period_s)
    return np.asarray(60.0 * (values[late] - values[early]) / span_s)


def derive(driver: DriftDriver, values: Array, time_s: Array, period_s: float) -> Array:
    """Return a driver [n] from the channel that it is made of, stretch by stretch.

    Args:
        driver: what is wanted.
        values: [n] the channel as it was logged.
        time_s: [n] on the log's own clock.
        period_s: from sample to sample.
    """
    if driver.form == VALUE:
        return values
    parts = []
    for rows in find_stretches(time_s, period_s):
        own = np.asarray(values[rows], dtype=np.float64)
        if driver.form == RATE:
            parts.append(measure_slope(np.asarray(time_s[rows]), own, period_s))
        else:
            parts.append(own - lowpass(own, period_s, driver.tau_s))
    return np.concatenate(parts)


def suspect(
    needs: Sequence[str], parameters: Mapping[str, float], channels: Sequence[str], output: str
) -> tuple[DriftDriver, ...]:
    """Return what an effect follows, the one that tells it best first.

    Args:
        needs: signals that the effect declares; `a|b` is one of them.
        parameters: its fitted values: a time constant makes a lag of the channel, a delay a rate.
        channels: what the runs have, as `DriftDriver.channel` names it.
        output: whose drift is looked at; a load is that on it, or else the first there is.
    """
    loads = [name for name in (f"load {output}", *channels) if name in channels]
    load = next((name for name in loads if name.startswith("load ")), None)
    found: list[str] = []
    for need in needs:
        own = [name for name in need.split("|") if name in channels]
        if need in LOADS:
            own = [load] if load is not None else []
        if need in TIMES:
            own = [TIME]
        found += own[:1]
    # The temperature is always drawn; what else the effect needs tells more.
    order = sorted(dict.fromkeys(found), key=lambda name: name == TEMPERATURE)
    drivers = []
    for name in order:
        memory = [
            (form, parameters[p]) for p, form in FORMS_OF_PARAMETERS.items() if p in parameters
        ]
        if name != TIME:
            drivers += [DriftDriver(name, f, tau if f == LAG else TAU_S) for f, tau in memory[:1]]
        drivers.append(DriftDriver(name))
    return tuple(drivers)
