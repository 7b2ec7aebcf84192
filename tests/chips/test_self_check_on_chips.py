"""Each flag, settling, saved states, damage and the self-test, on the host and on emulated cores.

What a flag has to be is worked out here, from the guards and an unlimited reference.
"""

import importlib.util
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.golden.model_factory import Draw
from tests.golden.vectors import load

from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.export.integer_model import (
    FLAG_CLAMPED,
    FLAG_DAMAGED,
    FLAG_RATE_RANGE,
    FLAG_TEMPERATURE_RANGE,
    FLAG_WARMING_UP,
    IntegerModel,
)
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import INT32_MAX, INT32_MIN

if any(importlib.util.find_spec(name) is None for name in ("unicorn", "ziglang")):
    pytest.skip("emulation needs the unicorn and ziglang wheels", allow_module_level=True)

from zerodrift.c_runtime.emulator import EmulatedModel

TABLES = 2
"""FAULT_TABLES of the generated header."""
HOST, VERSION_BYTES, HEADER_BYTES = "host", 4, 12
PLACES = [
    HOST,
    "cortex-m4",
    *(pytest.param(core, marks=pytest.mark.slow) for core in ("cortex-m0plus", "rv32imc")),
]
Found = tuple[NDArray[np.int32], NDArray[np.uint32]]


class Device:
    """A model on the host or on an emulated core."""

    def __init__(self, model: IntegerModel, place: str, folder: Path) -> None:
        self.model = model
        folder.mkdir(parents=True, exist_ok=True)
        code = generate(model)
        self.host = HostModel(model, code, folder, observe=False) if place == HOST else None
        self.chip = None if self.host else EmulatedModel(model, code, place, folder)
        self.save = (self.host or self.chip).save
        self.restore = (self.host or self.chip).restore
        self.selftest = (self.host or self.chip).selftest

    def run(self, codes: NDArray[np.int16], *, settled: bool = True, restart: bool = True) -> Found:
        """Return drift [T, K] and flags [T]."""
        if self.chip:
            return self.chip.run(codes, settled=settled, restart=restart)
        trace = self.host.run(codes, settled=settled, restart=restart)
        return trace.drift, trace.flags

    def flip_state_bit(self, bit: int) -> None:
        """Damage the running state."""
        if self.chip:
            self.chip.flip_bit("chip_state", bit)
        else:
            state = self.host._state
            state[bit // 8] = bytes([state.raw[bit // 8] ^ 1 << bit % 8])


def limit(model: IntegerModel, low: tuple[int, ...], high: tuple[int, ...]) -> IntegerModel:
    """Return the model with other limits of its correction."""
    return replace(model, nodes=(*model.nodes[:-1], replace(model.drift, low=low, high=high)))


def draw_walk(model: IntegerModel) -> NDArray[np.int16]:
    """Return codes [T, C] that touch each limit of the guards, and go one code beyond it."""
    guards = model.guards
    low, high, rate = guards.temperature_low, guards.temperature_high, guards.rate_max
    temperature = [0, 0, rate, 0, -rate, 0, rate + 1, 0, 0, -rate - 1, 0, 0]
    temperature += [low, low - 1, low, high, high + 1, high, -32768, 32767, 0]
    codes = Draw(7).codes(-9000, 9000, len(temperature) + 60, len(model.channels))
    codes[: len(temperature), guards.temperature_channel] = temperature
    return codes


@pytest.fixture(scope="module")
def limited() -> tuple[IntegerModel, NDArray[np.int32]]:
    """A model whose correction is limited in about a fifth of the steps; its drift unlimited."""
    model = load("ordinary").model
    assert not model.feeds_back
    outputs = len(model.outputs)
    free = limit(model, (INT32_MIN,) * outputs, (INT32_MAX,) * outputs)
    unlimited = Reference(free).run(draw_walk(model)[None], settled=False).drift[0]
    low, high = (np.quantile(unlimited, q, axis=0).astype(int).tolist() for q in (0.1, 0.9))
    return limit(model, tuple(low), tuple(high)), unlimited


@pytest.fixture(scope="module", params=PLACES)
def device(
    request: pytest.FixtureRequest,
    limited: tuple[IntegerModel, NDArray[np.int32]],
    tmp_path_factory: pytest.TempPathFactory,
) -> Device:
    return Device(limited[0], request.param, tmp_path_factory.mktemp("device"))


def test_every_flag_is_told_when_it_should_be_and_only_then(
    device: Device, limited: tuple[IntegerModel, NDArray[np.int32]]
) -> None:
    model, unlimited = limited
    guards, codes = model.guards, draw_walk(model)
    drift, flags = device.run(codes, settled=False)
    temperature = codes[:, guards.temperature_channel].astype(int)
    change = np.abs(np.diff(temperature, prepend=temperature[:1]))
    limits = np.array(model.drift.low), np.array(model.drift.high)
    expected = (
        FLAG_WARMING_UP * (np.arange(len(codes)) < guards.warm_up_steps)
        + FLAG_TEMPERATURE_RANGE
        * ((temperature < guards.temperature_low) | (temperature > guards.temperature_high))
        + FLAG_RATE_RANGE * (change > guards.rate_max)
        + FLAG_CLAMPED * ((unlimited < limits[0]) | (unlimited > limits[1])).any(axis=1)
    )
    np.testing.assert_array_equal(flags, expected)
    np.testing.assert_array_equal(drift, np.clip(unlimited, *limits))
    for flag in (FLAG_WARMING_UP, FLAG_TEMPERATURE_RANGE, FLAG_RATE_RANGE, FLAG_CLAMPED):
        assert 0 < np.count_nonzero(flags & flag) < len(flags)


def test_settled_start_is_at_rest_and_carries_no_warm_up(device: Device) -> None:
    row = np.full((1, len(device.model.channels)), 800, dtype=np.int16)
    codes = np.repeat(row, 400, axis=0)
    drift, flags = device.run(codes)
    assert not (flags & FLAG_WARMING_UP).any()
    assert np.abs(drift.astype(int) - drift[-1]).max() <= 1
    cold, told = device.run(codes, settled=False)
    assert np.count_nonzero(told & FLAG_WARMING_UP) == device.model.guards.warm_up_steps
    assert np.abs(cold[0].astype(int) - drift[0]).max() > 100


def test_restored_state_goes_on_to_the_bit(device: Device) -> None:
    codes = Draw(8).codes(-9000, 9000, 60, len(device.model.channels))
    drift, flags = device.run(codes)
    device.run(codes[:31])
    saved = device.save()
    device.run(codes[::-1])
    assert device.restore(saved) == 0
    after, told = device.run(codes[31:], restart=False)
    np.testing.assert_array_equal(after, drift[31:])
    np.testing.assert_array_equal(told, flags[31:])


def test_copy_that_is_not_sound_is_refused_and_leaves_a_cold_start(device: Device) -> None:
    codes = Draw(9).codes(-9000, 9000, 20, len(device.model.channels))
    cold = device.run(codes, settled=False)
    device.run(codes)
    saved = device.save()
    version = struct.unpack_from("<I", saved)[0]
    newer = struct.pack("<I", version + 1) + saved[VERSION_BYTES:-4]
    nonsense = saved[:HEADER_BYTES] + b"\x7f" * (len(saved) - HEADER_BYTES - 4)
    copies = [body + struct.pack("<I", zlib.crc32(body)) for body in (newer, nonsense)]
    for bit in range(0, 8 * len(saved), 61):
        flipped = bytearray(saved)
        flipped[bit // 8] ^= 1 << bit % 8
        copies.append(bytes(flipped))
    for copy in copies:
        assert device.restore(copy) == 1
    after = device.run(codes, restart=False)
    for found, expected in zip(after, cold, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert device.restore(saved) == 0


@pytest.mark.parametrize("bit", [0, 31, 63], ids=["model", "model's end", "count of steps"])
def test_damaged_state_passes_the_raw_value_once_and_starts_again(device: Device, bit: int) -> None:
    codes = Draw(10).codes(-3000, 3000, 12, len(device.model.channels))
    cold = device.run(codes[1:], settled=False)
    device.run(codes)
    device.flip_state_bit(bit)
    drift, flags = device.run(codes, restart=False)
    assert flags[0] == FLAG_DAMAGED and not drift[0].any()
    np.testing.assert_array_equal(drift[1:], cold[0])
    np.testing.assert_array_equal(flags[1:], cold[1])


@pytest.mark.parametrize("name", ["ordinary", "effects", "int8_before", "front_end"])
@pytest.mark.spread(2, "core", PLACES[1:])
def test_selftest_finds_a_bit_flipped_in_any_constant(core: str, name: str, tmp_path: Path) -> None:
    """Weights, tables, whatever array lies in the flash of the emulated core."""
    chip = EmulatedModel(model := load(name).model, generate(model), core, tmp_path)
    assert chip.selftest() == 0
    # a structure holds pointers to arrays: a chip with one of those damaged does not get this far
    arrays = {symbol: size for symbol, size in chip.arrays.items() if not is_structure(symbol)}
    assert any("tanh" in symbol for symbol in arrays)
    assert any("exp2" in symbol for symbol in arrays) == any(n.kind == "exp2" for n in model.nodes)
    missed = []
    for symbol, size in arrays.items():
        for bit in (1, 4 * size, 8 * size - 2):
            chip.flip_bit(symbol, bit)
            if not chip.selftest() & TABLES:
                missed.append((symbol, bit))
            chip.flip_bit(symbol, bit)
    assert missed == []
    assert chip.selftest() == 0


def is_structure(symbol: str) -> bool:
    """Tell a kernel's description (gru, power_6_p) from an array (gru_stream, power_6_gains)."""
    return symbol.endswith("_p") or "_" not in symbol
