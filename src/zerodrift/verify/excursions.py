"""Where held-out runs leave the ranges that the training runs calibrated: run, channel, time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.dataset.code_format import MEASURED
from zerodrift.dataset.runs import Run
from zerodrift.export.integer_model import Channel, IntegerModel
from zerodrift.verify.chip_error import RATE, ChipReplay

TEMPERATURE = "temperature_degC"
KELVIN_APART = 150.0
"""K beyond the calibrated range from which a log is rather in kelvin than so hot."""


@dataclass(frozen=True)
class Excursion:
    """One run that leaves one calibrated range on one side."""

    run: str
    channel: str
    """Of the model, or "rate"."""
    unit: str
    side: str
    """above | below."""
    beyond: float
    """How far from the calibrated range, in the channel's unit."""
    reach: float
    """The value furthest from it."""
    from_s: float
    """The log's time of the first such row."""
    rows: int

    def __str__(self) -> str:
        """Return it as a sentence that says what to record."""
        place = f"from {self.from_s:g} s"
        if self.channel == RATE:
            return (
                f"{self.run} changes its temperature faster than any training run, by"
                f" {self.beyond:.2g} {self.unit}, {place}; record changes up to"
                f" {self.reach:.2g} {self.unit}"
            )
        whose = "" if self.unit == "K" else f" of {self.channel}"
        unit = "degC" if self.unit == "K" else self.unit
        end = np.ceil if self.side == "above" else np.floor
        reach = end(self.reach) if self.unit == "K" else self.reach
        if self.unit == "K" and self.beyond > KELVIN_APART:
            return (
                f"{self.run} leaves the calibrated range by {self.beyond:.3g} K {place}, to"
                f" {self.reach:.4g} degC; if it is in kelvin, subtract 273.15"
            )
        towards = "up to" if self.side == "above" else "down to"
        return (
            f"{self.run} leaves the calibrated range{whose} by {self.beyond:.3g} {self.unit}"
            f" {place}; record {towards} {reach:.4g} {unit}"
        )


def list_excursions(replay: ChipReplay, train: Sequence[Run]) -> tuple[Excursion, ...]:
    """Return where the replayed runs leave the ranges of the training runs.

    Args:
        replay: the held-out runs.
        train: what was calibrated on.
    """
    found = []
    for name in dict.fromkeys(channel for r in replay.runs for channel in r.outside):
        low, high, unit = _find_range(replay.model, name, train)
        for group in dict.fromkeys(r.run.group for r in replay.runs):
            own = [r for r in replay.runs if r.run.group == group and r.outside[name].any()]
            if not own:
                continue
            values = np.concatenate(
                [_read(replay.model, name, r.run)[r.outside[name]] for r in own]
            )
            times = np.concatenate([r.run.time_s[r.outside[name]] for r in own])
            for side, beyond in (("above", values - high), ("below", low - values)):
                rows = beyond > 0.0
                if rows.any():
                    worst = int(np.argmax(beyond))
                    found.append(
                        Excursion(
                            run=group,
                            channel=name,
                            unit=unit,
                            side=side,
                            beyond=float(beyond[worst]),
                            reach=float(values[worst]),
                            from_s=float(times[rows].min()),
                            rows=int(rows.sum()),
                        )
                    )
    return tuple(found)


def _find_range(model: IntegerModel, name: str, train: Sequence[Run]) -> tuple[float, float, str]:
    """Return lowest, highest and unit of a channel over the training runs."""
    channel = next((c for c in model.channels if c.name == name), None)
    if channel is not None and channel.source.startswith(MEASURED):
        k = _find_output(model, channel)
        values = np.concatenate([run.reference[:, k] for run in train])
    else:
        values = np.concatenate([_read(model, name, run) for run in train])
    unit = "K per step" if channel is None else channel.unit
    return float(values.min()), float(values.max()), "K" if unit == "degC" else unit


def _read(model: IntegerModel, name: str, run: Run) -> Array:
    """Return the values [n] of a channel as they were logged; of a load, its reference."""
    if name == RATE:
        steps = np.abs(np.diff(run.temperature_degC, prepend=run.temperature_degC[:1]))
        return np.asarray(steps)
    channel = next(c for c in model.channels if c.name == name)
    if channel.source == TEMPERATURE:
        return run.temperature_degC
    if channel.source.startswith(MEASURED):
        return np.asarray(run.reference[:, _find_output(model, channel)])
    return run.inputs[channel.source]


def _find_output(model: IntegerModel, channel: Channel) -> int:
    names = [output.name for output in model.outputs]
    return names.index(channel.source.removeprefix(MEASURED))
