"""Whether what a network is shown reaches as far back as the drift remembers."""

from collections.abc import Sequence
from dataclasses import dataclass

from zerodrift.base.config import RECURRENT_KINDS, WINDOW, WINDOWED_KINDS, NetworkConfig
from zerodrift.diagnosis.memory import MemoryTable

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
