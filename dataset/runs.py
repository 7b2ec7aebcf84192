"""What a log becomes: uninterrupted stretches at one sample period, with units in the names."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """One uninterrupted stretch of one run, resampled to the firmware's period.

    A gap in a log ends a stretch: the parts share `group` (what is held out together, and what a
    per-run offset belongs to) and differ in `part`. All arrays have the same length n.
    """

    name: str
    """Unique name: the group, and `#2`, `#3`, ... for the parts after a gap."""
    group: str
    """The run as the user knows it: the file's stem, or the value of the `run` column."""
    part: int
    """0 for the first stretch of the run, then 1, 2, ..."""
    source: Path
    """The log it was read from."""
    sample_period_s: float
    time_s: Array
    """[n] uniform, seconds on the log's own clock."""
    temperature_degC: Array
    """[n] what the chip's thermometer reported."""
    measured: Array
    """[n, K] the outputs before compensation, each in its unit, in the order of the config.

    Stored output by output (Fortran order), as is `reference`.
    """
    reference: Array
    """[n, K] what the outputs should have been; zero where the config names no reference."""
    inputs: Mapping[str, Array] = field(default_factory=dict)
    """Optional channels [n] by the name that effects use: supply, humidity, clock, ..."""
    start_s: float | None = None
    """The log's own clock at the first row of the whole run; None: at this stretch's first."""
    before: "Run | None" = field(default=None, repr=False, compare=False)
    """The stretch of the same run before the gap; None for the first, or to begin at rest."""

    def at_rest(self) -> "Run":
        """Return the stretch as if nothing had been before it, as a chip takes it."""
        return self if self.before is None else replace(self, before=None)

    def take(self, rows: slice) -> "Run":
        """Return some of the stretch's samples, one after the other."""
        return replace(
            self,
            time_s=self.time_s[rows],
            temperature_degC=self.temperature_degC[rows],
            measured=self.measured[rows],
            reference=self.reference[rows],
            inputs={name: values[rows] for name, values in self.inputs.items()},
        )

    @property
    def drift(self) -> Array:
        """[n, K] measured minus reference: what the compensator has to predict."""
        return self.measured - self.reference

    def __len__(self) -> int:
        """Return the number of samples."""
        return int(self.time_s.size)


@dataclass(frozen=True)
class Dataset:
    """All runs of a project by their use."""

    train: tuple[Run, ...]
    test: tuple[Run, ...]
    """Empty when the config names no test logs: then runs are left out one at a time."""
    dwell: tuple[Run, ...]
    """Isothermal, unloaded; sets the noise floor. May be empty."""
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    full_scale: tuple[float, ...]
    notes: tuple[str, ...] = ()
    """What was noticed while reading and is worth a look: gaps, rows left out, odd units."""
