"""Sections 2.1 and 5 of docs/reference/integer-arithmetic.md: a model, step by step."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.oracle.conversion import convert
from tests.oracle.layers import Dense, Drift, Head, Join, LayerNorm, Recurrent, RecurrentLstm
from tests.oracle.primitives import fit
from tests.oracle.signals import SIGNALS, Features, Signal

WARMING_UP, TEMPERATURE, RATE, LIMITED, INPUT_RANGE, NO_READING = 1, 2, 4, 8, 32, 64
REST_PASSES = 4

Value = int | list[int]


@dataclass(frozen=True)
class Answer:
    """What one step gives."""

    drift: list[int]
    flags: int
    values: dict[str, Value]
    """The value of every node but the drift; empty while the state is new."""


class Oracle:
    """A model file, run."""

    def __init__(self, path: Path) -> None:
        """Read the file; the state is new."""
        body: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        assert body["format"] in (2, 3)
        hashed = {key: value for key, value in body.items() if key not in ("hash", "notes")}
        text = json.dumps(hashed, sort_keys=True, separators=(",", ":"))
        assert hashlib.sha256(text.encode()).hexdigest() == body["hash"]
        self.nodes: list[dict[str, Any]] = body["nodes"]
        self.channels: list[dict[str, Any]] = body["channels"]
        self.guards: dict[str, Any] = body["guards"]
        self.outputs = len(body["outputs"])
        self.units: dict[str, Any] = {node["name"]: _make(node) for node in self.nodes}
        self.reads_load = any(node["kind"] == "load" for node in self.nodes)
        self.init()

    def init(self) -> None:
        """Mark the state as new."""
        self.new = True
        self.steps = 0
        self.codes = [0] * len(self.channels)
        self.drift = [0] * self.outputs

    def settle(self, codes: Sequence[int]) -> None:
        """Put everything to rest at these codes."""
        self.init()
        codes = convert(self.channels, codes)
        if any(self._find_missing(codes)):
            return
        self._begin(codes, settled=True)
        self.steps = self.guards["warm_up_steps"]
        self.codes = list(codes)

    def step(self, codes: Sequence[int]) -> Answer:
        """Compute one step."""
        codes = convert(self.channels, codes)
        for code, channel in zip(codes, self.channels, strict=True):
            fit(code, channel["bits"])
        missing = self._find_missing(codes)
        if self.new and any(missing):
            warming = WARMING_UP if self.guards["warm_up_steps"] > 0 else 0
            return Answer([0] * self.outputs, NO_READING | warming, {})
        current = [
            last if gone else code
            for code, last, gone in zip(codes, self.codes, missing, strict=True)
        ]
        previous: Sequence[int] = self.codes
        if self.new:
            previous = current
            self._begin(current, settled=False)
        flags = NO_READING if any(missing) else 0
        flags |= self._guard(current, previous)
        if self.steps < self.guards["warm_up_steps"]:
            flags |= WARMING_UP
        values, drift, limited = self._compute(current)
        flags |= LIMITED if limited else 0
        self.steps = min(self.steps + 1, self.guards["warm_up_steps"])
        self.codes, self.drift = current, drift
        return Answer(drift, flags, values)

    def _find_missing(self, codes: Sequence[int]) -> list[bool]:
        return [
            "no_reading" in channel and code == channel["no_reading"]
            for code, channel in zip(codes, self.channels, strict=True)
        ]

    def _guard(self, codes: Sequence[int], previous: Sequence[int]) -> int:
        guards, flags = self.guards, 0
        channel = guards["temperature_channel"]
        if not guards["temperature_low"] <= codes[channel] <= guards["temperature_high"]:
            flags |= TEMPERATURE
        if abs(codes[channel] - previous[channel]) > guards["rate_max"]:
            flags |= RATE
        for other, low, high in guards.get("ranges", []):
            if not low <= codes[other] <= high:
                flags |= INPUT_RANGE
        return flags

    def _begin(self, codes: Sequence[int], *, settled: bool) -> None:
        """Put everything to rest; where effects read the load, with the drift that goes with it."""
        self.new = False
        self.drift = [0] * self.outputs
        for _ in range(REST_PASSES if self.reads_load else 0):
            self._rest(codes, settled=settled)
            self.drift = self._compute(codes)[1]
        self._rest(codes, settled=settled)

    def _rest(self, codes: Sequence[int], *, settled: bool) -> None:
        values: dict[str, Value] = {}
        for node in self.nodes:
            name, unit = node["name"], self.units[node["name"]]
            if isinstance(unit, Signal):
                values[name] = unit.rest(self._read(node, values, codes))
            elif isinstance(unit, Features):
                values[name] = unit.step(self._read(node, values, codes))
            elif isinstance(unit, Recurrent):
                features = values[node["inputs"][0]]
                assert isinstance(features, list)
                unit.begin(features, settled=settled)
                values[name] = unit.h_q30[-1]
            elif isinstance(unit, Dense | Join | LayerNorm):
                values[name] = unit.step(self._read(node, values, codes))

    def _compute(self, codes: Sequence[int]) -> tuple[dict[str, Value], list[int], bool]:
        values: dict[str, Value] = {}
        for node in self.nodes:
            unit = self.units[node["name"]]
            if isinstance(unit, Drift):
                phi, y = list(node["inputs"]), []
                if unit.head is not None:
                    y = values[phi.pop()]
                drift, limited = unit.step([values[name] for name in phi], y)
                return values, drift, limited
            values[node["name"]] = unit.step(self._read(node, values, codes))
        raise AssertionError("a model ends in a drift")

    def _read(
        self, node: dict[str, Any], values: dict[str, Value], codes: Sequence[int]
    ) -> list[int]:
        if node["kind"] == "input":
            return [codes[node["channel"]]]
        if node["kind"] == "load":
            return [codes[node["channel"]], self.drift[node["output"]]]
        inputs = [values[name] for name in node["inputs"]]
        if len(inputs) == 1 and isinstance(inputs[0], list) and node["kind"] != "join":
            return inputs[0]
        return inputs


def _make(node: dict[str, Any]) -> Any:
    kind = node["kind"]
    if kind in SIGNALS:
        return SIGNALS[kind](node)
    others = {
        "features": Features,
        "gru": Recurrent,
        "gru_stack": Recurrent,
        "dense": Dense,
        "layer_norm": LayerNorm,
        "feature_dense": Dense,
        "head": Head,
        "join_head": Head,
        "join": Join,
        "lstm": RecurrentLstm,
        "drift": Drift,
    }
    return others[kind](node)
