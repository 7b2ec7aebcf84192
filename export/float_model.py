"""The float model: the graph of operations with parameters that describes every compensator.

Physics, lag bank, trained and imported networks all become one; quantizer and exporters read
nothing else.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zerodrift.base.arrays import Array, Mask
from zerodrift.base.errors import CheckError
from zerodrift.dataset.chip_codes import TEMPERATURE
from zerodrift.dataset.runs import Run, predict_all, predict_along
from zerodrift.export.float_network import FloatNetwork
from zerodrift.export.integer_model import Channel, OutputFormat
from zerodrift.operations.backend import evaluate
from zerodrift.operations.operation import Node, list_nodes
from zerodrift.physics.signals import SignalPlan, graph_inputs, read_signals
from zerodrift.physics.summary import ModelSummary

# The float model's prediction on the chip, where the load is the compensated output.

MOST_ROUNDS = 200
SETTLED = 1e-9
"""The rounds end when no drift moves by more than this share of the largest."""


def predict_fed_back(predict: Callable[[Run], Array], run: Run) -> Array:
    """Return the drift [n, K] with the load of each step taken from the step before.

    The chip does not know the true load. It takes load[n] = measured[n] - drift[n-1], the present
    raw output less the drift found one step before, and so does this: from the true loads on, the
    whole run is predicted again with the loads that the last round's drift leaves, until nothing
    moves. Since a drift depends on earlier ones only, that is the one solution of the loop.

    Args:
        predict: run -> drift [n, K], which takes the loads from `run.reference`.
        run: the run; at its start the loop is at rest.

    Raises:
        CheckError: the loop does not converge: the effects of the load are too strong.
    """
    drift = predict(run)
    for _ in range(MOST_ROUNDS):
        before = np.concatenate([drift[:1], drift[:-1]])
        again = predict(replace(run, reference=run.measured - before))
        moved = float(np.abs(again - drift).max(initial=0.0))
        largest = float(np.abs(again).max(initial=0.0))
        drift = again
        if moved <= SETTLED * largest:
            return drift
    raise CheckError(
        f"run '{run.name}': effects of the load feed on themselves: after {MOST_ROUNDS} rounds the"
        f" drift still moves by {moved:.3g}. On the chip the load is what the compensator leaves of"
        " the raw output, so an effect may take only a part of it. Remove the last load effect, or"
        " hold its parameters."
    )


# The float model: the graph of operations with parameters that describes every compensator.

LOAD = "load:"
"""What names of the graph's signals of loads begin with."""
SATURATED = "saturated:"
"""And of the marks of converters at a rail."""


@dataclass(frozen=True)
class FloatModel:
    """A whole compensator in float: drift = features . coefficients + offset + network(taps)."""

    name: str
    sample_period_s: float
    channels: tuple[Channel, ...]
    sources: dict[str, int]
    """Signal name of the graph -> channel index."""
    outputs: tuple[OutputFormat, ...]
    features: tuple[Node, ...]
    coefficients: Array
    """[J, K] output units per feature unit."""
    offset: Array
    """[K] output units."""
    taps: tuple[Node, ...] = ()
    tap_mean: Array | None = None
    """[I]."""
    whitening: Array | None = None
    """[I', I]: the network's input is whitening @ (taps - mean)."""
    network: FloatNetwork | None = None
    window: int = 0
    """0: the network's state is carried from sample to sample."""
    feature_names: tuple[str, ...] = ()
    """Of the features, for messages."""
    clock_origin_s: float = 0.0
    """Where clock_s counts from on the clock's channel."""
    plan: SignalPlan | None = None
    """How loads, times and saturation are read; None: the graph reads only logged columns."""
    tared: bool = False
    """Whether each log had an offset of its own, that of its tare, which is not predicted."""
    set_aside: tuple[str, ...] = ()
    """Outputs whose samples at a converter's rail do not show the drift."""
    physics: "FloatModel | None" = None
    """The physical model alone, where something was learnt beside it."""
    effects: ModelSummary | None = None
    """Summary of the physical model, for readers of the firmware; None where there is none."""
    variable_step: bool = False
    """Whether each step is given the time since the last one."""

    def read_inputs(self, run: Run) -> dict[str, Array]:
        """Return the graph's signals [n] of a run by name, loads those of its reference."""
        if self.plan is None:
            return {**run.inputs, TEMPERATURE: run.temperature_degC}
        return {**run.inputs, **graph_inputs(read_signals(run, self.plan))}

    def read_inputs_on_chip(self, run: Run) -> dict[str, Array]:
        """Return the graph's signals [n] of a run by name, loads as the chip knows them."""
        if self._reads_loads:
            drift = self.predict_on_chip(run)
            before = np.concatenate([drift[:1], drift[:-1]])
            run = replace(run, reference=run.measured - before)
        return self.read_inputs(run)

    def predict(self, run: Run) -> Array:
        """Return the drift [n, K] of a run with loads as its reference tells, each in its unit.

        The run is taken to be at rest before its first sample, and signals to be straight lines in
        gaps.
        """
        if run.before is not None:
            return predict_along(self.predict, run)
        values = evaluate([*self.features, *self.taps], self.read_inputs(run), self.sample_period_s)
        count = len(self.features)
        drift = np.broadcast_to(self.offset, (len(run), len(self.outputs))).copy()
        if count:
            drift += np.stack(values[:count], axis=1) @ self.coefficients
        if self.network is not None:
            drift += self._run_network(np.stack(values[count:], axis=1))
        return drift

    def predict_on_chip(self, run: Run) -> Array:
        """Return the drift [n, K] of a run with loads as the chip knows them."""
        if run.before is not None:
            return predict_along(self.predict_on_chip, run)
        if self._reads_loads:
            return predict_fed_back(self.predict, run)
        return self.predict(run)

    def predict_all(self, runs: Sequence[Run]) -> list[Array]:
        """Return `predict` [n, K] of every run; each chain of stretches is computed once."""
        return predict_all(self.predict, runs)

    def predict_all_on_chip(self, runs: Sequence[Run]) -> list[Array]:
        """Return `predict_on_chip` [n, K] of every run; each chain of stretches is computed
        once."""
        return predict_all(self.predict_on_chip, runs)

    def predict_network(self, run: Run) -> Array:
        """Return what the network adds to the drift [n, K] of a stretch from rest."""
        return self._run_network(self._compute_taps(run.at_rest()))

    def compute_network_inputs(self, run: Run) -> Array:
        """Return the network's input [n, I'] of a run."""
        return self._whiten(self._compute_taps(run))

    def find_usable(self, run: Run) -> Mask:
        """Return [n, K] which samples show the drift."""
        usable = np.ones(run.measured.shape, dtype=np.bool_)
        if self.set_aside:
            names = [output.name for output in self.outputs]
            inputs = self.read_inputs(run)
            for name in self.set_aside:
                usable[:, names.index(name)] = inputs[SATURATED + name] == 0.0
        return usable

    @property
    def _reads_loads(self) -> bool:
        return any(node.source.startswith(LOAD) for node in list_nodes(self.features))

    def _compute_taps(self, run: Run) -> Array:
        return np.stack(evaluate(self.taps, self.read_inputs(run), self.sample_period_s), axis=1)

    def _whiten(self, taps: Array) -> Array:
        assert self.tap_mean is not None and self.whitening is not None
        return np.asarray((taps - self.tap_mean) @ self.whitening.T)

    def _run_network(self, taps: Array) -> Array:
        """Return the network's outputs [n, K] for taps [n, I] that begin at rest."""
        assert self.network is not None
        return self.network.answer(self._whiten(taps), self.window)


@dataclass(frozen=True)
class Calibration:
    """The ranges in the training logs, from which formats and guards are chosen."""

    code_limits: tuple[tuple[int, int], ...]
    """Per channel: inputs outside are limited to these codes; for a raw output, the load is."""
    feature_max: Array
    """[I'] largest absolute value of each network input."""
    drift_low: Array
    drift_high: Array
    """[K] the correction is limited to this range, in output units."""
    rate_max: int
    """Temperature codes per step."""
    warm_up_steps: int
    temperature_range: tuple[int, int] | None = None
    """Codes outside of which the temperature is flagged; None for its code limits."""
    input_ranges: tuple[tuple[int, int, int], ...] = ()
    """(channel, lowest, highest code) of the other inputs, outside of which they are flagged."""
    ranges: Mapping[Node, tuple[float, float]] = field(default_factory=dict)
    """Lowest and highest value of the graph's nodes, as far as known: results are limited where
    they could go far beyond, so that their formats suit what they are."""
