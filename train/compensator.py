"""The trained compensator: physics, the linear part, the network; it predicts, saves and loads.

Nothing here needs PyTorch: the network is its ONNX file, run by onnxruntime.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.errors import InputError
from zerodrift.base.journal import write_all
from zerodrift.base.records import (
    OPTIONAL,
    from_json,
    read_format,
    read_sealed,
    render_sealed,
    to_dict,
)
from zerodrift.dataset.runs import Run, predict_all, predict_along
from zerodrift.operations.dense import FloatFeedForward
from zerodrift.operations.operation import list_nodes
from zerodrift.physics.catalogue import Catalogue
from zerodrift.physics.model import ModelRecord, PhysicalModel
from zerodrift.train.front_end import FrontEnd
from zerodrift.train.lag_bank.model import LagBank, LagBankRecord
from zerodrift.train.onnx_export import OnnxNetwork, read_onnx_layers, read_onnx_weights

FORMAT = 3
"""Version of compensator.json; another one is refused."""
DESCRIPTION, NETWORK = "compensator.json", "network.onnx"
BIASES = (".B", ".bias")
"""Ends of the names of weights that are added, not multiplied by."""


@dataclass(frozen=True)
class TrainedRanges:
    """Ranges of the training logs; beyond them the compensator has not been tested."""

    temperature_degC: tuple[float, float]
    """Lowest and highest."""
    rate_K_per_s: float
    """Largest change of the temperature from one sample to the next, per second."""
    drift: Array
    """[2, K] lowest and highest measured drift, in the outputs' units."""
    predicted: Array
    """[2, K] lowest and highest predicted drift, in the outputs' units."""
    feature: Array
    """[I] largest absolute value of each feature of the network; empty without one."""


@dataclass(frozen=True)
class TrainedAs:
    """How a network's last training went, so that it can be repeated without some of the runs."""

    start: int
    """Number of the first weights."""
    epochs: int


@dataclass(frozen=True)
class Compensator:
    """drift = physics + features linear + constant + network(features), in the outputs' units."""

    physics: PhysicalModel
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    sample_period_s: float
    calibration: TrainedRanges
    front_end: FrontEnd | None = None
    """None where physics stands alone."""
    linear: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """[I, K] output units per unit of each feature; zeros where a linear part did not help."""
    constant: Array = field(default_factory=lambda: np.zeros(0))
    """[K] added where all features are zero, in the outputs' units; only with a front end."""
    network: bytes | None = None
    """The ONNX file of `zerodrift.train.onnx_export`, or None without a network."""
    memory: str | int = "stream"
    """"stream": the state goes from sample to sample; else the length of the window."""
    bank: LagBank | None = None
    """Powers of thermometers and their lags, for `[network] kind = "lag_bank"`."""
    tared: bool = False
    """Whether each log had an offset of its own, that of its tare, which is not predicted."""
    trained_from: str = ""
    """Mark of the configuration and logs it was trained from."""
    notes: tuple[str, ...] = ()
    """Notes of the training on the result."""
    trained_as: TrainedAs | None = None
    """None without a network, and in files from before this was kept."""

    def predict(self, run: Run) -> Array:
        """Return the predicted drift [n, K] of a run, each output in its unit.

        The run is taken to be at rest before its first sample, and signals to be straight lines in
        gaps.
        """
        if run.before is not None:
            return predict_along(self.predict, run)
        drift = self.physics.predict(run)
        if self.bank is not None:
            drift = drift + self.physics.features(run) @ self.bank.correction
            drift = drift + self.bank.compute(run, self.outputs) @ self.bank.coefficients
        if self.front_end is None:
            return np.asarray(drift)
        features = self.front_end.compute(run)
        drift = drift + features @ self.linear + self.constant
        if self.network is not None:
            drift = drift + self._run_network(features)
        return np.asarray(drift)

    @property
    def is_physics_alone(self) -> bool:
        """Whether nothing was learnt beside the physical model."""
        return self.bank is None and self.front_end is None

    def predict_all(self, runs: Sequence[Run]) -> list[Array]:
        """Return `predict` [n, K] of every run; each chain of stretches is computed once."""
        return predict_all(self.predict, runs)

    @property
    def tap_coefficients(self) -> Array:
        """[I, K] the linear part per unit of the raw taps, for the exporter."""
        assert self.front_end is not None
        return np.asarray(self.front_end.matrix.T @ self.linear)

    @property
    def tap_offset(self) -> Array:
        """[K] added where all taps are zero, so that linear part = taps coefficients + offset."""
        assert self.front_end is not None
        return np.asarray(self.constant - self.front_end.mean @ self.tap_coefficients)

    @property
    def parameters(self) -> int:
        """Numbers that were learnt: physics, linear part, network."""
        free = sum(len(fitted.term.free) for fitted in self.physics.terms)
        count = int(np.count_nonzero(self.physics.coefficients)) + free
        count += int(np.count_nonzero(self.linear)) + int(np.count_nonzero(self.constant))
        if self.network is not None:
            count += sum(x.size for x in self._network_weights.values())
        if self.bank is not None:
            count += self.bank.parameters
        return count

    @property
    def macs_per_step(self) -> int:
        """Multiplications of a step on the chip: the sums, the features, the network."""
        operations = list_nodes(self.physics.graph().features)
        inner = sum(node.op not in ("input", "constant") for node in operations)
        count = int(np.count_nonzero(self.physics.coefficients)) + 2 * inner
        count += int(np.count_nonzero(self.linear))
        if self.front_end is not None:
            count += self.front_end.width * (self.front_end.width + 1) // 2
            count += 2 * sum(tap.tau_s > 0.0 for tap in self.front_end.taps)
        if self.network is not None:
            steps = self.window or 1
            for name, weights in self._network_weights.items():
                if not name.endswith(BIASES):
                    count += (1 if name.startswith("head") else steps) * weights.size
        if self.bank is not None:
            count += self.bank.macs
        return count

    @cached_property
    def _network_weights(self) -> Mapping[str, Array]:
        """The numbers of the network's file, by name."""
        assert self.network is not None
        return read_onnx_weights(self.network, NETWORK)

    @property
    def is_recurrent(self) -> bool:
        """Whether the network carries a state, or is run over a window."""
        return self.network is not None and bool({"gru.W", "lstm.W"} & set(self._network_weights))

    @cached_property
    def feed_forward(self) -> FloatFeedForward:
        """The network's layers in float64, where it has no recurrence."""
        assert self.network is not None
        return read_onnx_layers(self.network, NETWORK)

    @cached_property
    def _recurrence(self) -> OnnxNetwork:
        assert self.network is not None
        return OnnxNetwork(self.network)

    @property
    def window(self) -> int:
        """Samples of the network's window; 0 where its state goes from sample to sample."""
        return 0 if self.memory == "stream" else int(self.memory)

    def _run_network(self, features: Array) -> Array:
        """Return the network's drift [n, K] for features [n, I] of a run that starts at rest."""
        if not self.is_recurrent:
            return self.feed_forward.run(features)
        return self._recurrence.run(features, self.window)

    def to_record(self) -> "CompensatorRecord":
        """Return everything but the network as compensator.json holds it."""
        return CompensatorRecord(
            format=FORMAT,
            outputs=self.outputs,
            units=self.units,
            sample_period_s=self.sample_period_s,
            physics=self.physics.to_record(),
            front_end=self.front_end,
            linear=self.linear,
            constant=self.constant,
            memory=self.memory,
            bank=self.bank.to_record() if self.bank else None,
            tared=self.tared,
            network_sha256=hashlib.sha256(self.network).hexdigest() if self.network else None,
            calibration=self.calibration,
            trained_from=self.trained_from,
            notes=self.notes,
            trained_as=self.trained_as,
        )

    def render(self, directory: Path) -> dict[Path, bytes | None]:
        """Return compensator.json and network.onnx; None for the latter where there is no network.

        The same compensator gives the same bytes. The description names the network's hash.
        """
        return {directory / NETWORK: self.network, directory / DESCRIPTION: self._seal()}

    def _seal(self) -> bytes:
        return render_sealed(dict(sorted(to_dict(self.to_record()).items())))

    def save(self, project: Path, directory: Path, *, done_with: Sequence[Path] = ()) -> None:
        """Write both files, as one change.

        Args:
            project: the folder of zerodrift.toml.
            directory: where the files lie.
            done_with: files of the training that are removed with the same change.

        Raises:
            InputError: they cannot be written; the old ones are as they were.
        """
        forgotten: dict[Path, bytes | None] = dict.fromkeys(p for p in done_with if p.exists())
        write_all(project, self.render(directory) | forgotten, at_once=True)

    @classmethod
    def load(cls, directory: Path, catalogue: Catalogue | None = None) -> "Compensator":
        """Return the compensator that `save` wrote.

        Args:
            directory: the project's build directory.
            catalogue: needed where the model has a user's own effects.

        Raises:
            InputError: the files are missing, damaged or of different trainings.
        """
        path = directory / DESCRIPTION
        if not path.exists():
            raise InputError(f"{path}: there is no trained compensator. Run `zerodrift train`.")
        try:
            content = path.read_bytes()
            found = read_format(content)
            if found != FORMAT:
                raise InputError(
                    f"{path}: written in format {found}, this version reads {FORMAT}. Run"
                    " `zerodrift train` again."
                )
            record = from_json(CompensatorRecord, read_sealed(content))
            return record.restore(_read_network(directory, record.network_sha256), catalogue)
        except (OSError, ValueError, TypeError, RecursionError) as error:
            raise InputError(
                f"{path}: damaged ({type(error).__name__}: {error}). Run `zerodrift train` again."
            ) from error


@dataclass(frozen=True)
class CompensatorRecord:
    """A compensator as compensator.json holds it; see `Compensator`."""

    format: int
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    sample_period_s: float
    physics: ModelRecord
    front_end: FrontEnd | None
    linear: Array
    constant: Array
    memory: str | int
    bank: LagBankRecord | None
    tared: bool
    network_sha256: str | None
    calibration: TrainedRanges
    trained_from: str
    notes: tuple[str, ...]
    trained_as: TrainedAs | None = field(default=None, metadata=OPTIONAL)

    def restore(self, network: bytes | None, catalogue: Catalogue | None) -> Compensator:
        """Return the compensator that `to_record` described.

        Args:
            network: the file beside it.
            catalogue: needed where the model has a user's own effects.
        """
        outputs = len(self.outputs)
        return Compensator(
            physics=PhysicalModel.from_record(self.physics, catalogue),
            outputs=self.outputs,
            units=self.units,
            sample_period_s=self.sample_period_s,
            calibration=self.calibration,
            front_end=self.front_end,
            linear=self.linear.reshape(-1, outputs),
            constant=self.constant,
            network=network,
            memory=self.memory,
            bank=self.bank.restore(outputs) if self.bank else None,
            tared=self.tared,
            trained_from=self.trained_from,
            notes=self.notes,
            trained_as=self.trained_as,
        )


def _read_network(directory: Path, expected: str | None) -> bytes | None:
    """Return the network's file if there is one, after checking that its hash is as expected."""
    if expected is None:
        return None
    path = directory / NETWORK
    content = path.read_bytes() if path.exists() else b""
    if hashlib.sha256(content).hexdigest() != expected:
        raise InputError(
            f"{path}: this is not the network that {DESCRIPTION} describes. Run `zerodrift train`"
            " again."
        )
    return content


def calibrate(
    runs: Sequence[Run], features: Sequence[Array], predictions: Sequence[Array]
) -> TrainedRanges:
    """Return the ranges that the training runs showed.

    Args:
        runs: training runs.
        features: [n, I] per run; empty without a front end.
        predictions: [n, K] per run, the compensator's drift.
    """
    steps = [float(np.abs(np.diff(run.temperature_degC)).max(initial=0.0)) for run in runs]
    drift = np.concatenate([run.drift for run in runs])
    predicted = np.concatenate(predictions)
    temperature = np.concatenate([run.temperature_degC for run in runs])
    return TrainedRanges(
        temperature_degC=(float(temperature.min()), float(temperature.max())),
        rate_K_per_s=max(steps) / runs[0].sample_period_s,
        drift=np.stack([drift.min(axis=0), drift.max(axis=0)]),
        predicted=np.stack([predicted.min(axis=0), predicted.max(axis=0)]),
        feature=np.abs(np.concatenate(features)).max(axis=0) if features else np.zeros(0),
    )
