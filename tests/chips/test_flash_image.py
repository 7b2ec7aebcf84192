"""The example firmware on an emulated Cortex-M4: its CAN frames are what the reference gave."""

import importlib.util
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.golden.vectors import load

from zerodrift.codegen.application import render_dbc
from zerodrift.export.integer_model import IntegerModel
from zerodrift.export.reference import Reference
from zerodrift.operations.arithmetic import CodeArray

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
needs_cantools = pytest.mark.skipif(
    importlib.util.find_spec("cantools") is None, reason="needs cantools: pip install cantools"
)


def load_builder() -> ModuleType:
    """Import the example's build script."""
    spec = importlib.util.spec_from_file_location("flash", ROOT / "examples/firmware/build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@needs_cantools
def test_dbc_is_read_by_cantools_and_scales_to_the_unit() -> None:
    import cantools

    model = load("front_end").model
    database = cantools.database.load_string(render_dbc(model), "dbc")
    assert len(database.messages) == 2 * len(model.outputs)
    for output, message in zip(model.outputs, database.messages[::2], strict=True):
        data = message.encode({"Raw": 5.0, "Drift": -2.5}, strict=False)
        assert int.from_bytes(data[:4], "little", signed=True) == 5 * output.lsb_per_unit
        signal = message.get_signal_by_name("Drift")
        assert signal.unit == output.unit


FLAG_THERMOMETER = 64
"""Of the application: no reading, the raw value passes."""
MISSING = (0, 1, 40, 41, 90)
"""Steps at which the thermometer has no reading yet."""


def draw_samples(name: str) -> tuple[IntegerModel, CodeArray, NDArray[np.int32]]:
    """Return a model, codes [T, C] and raw values [T, K]; "effects" reads an output's raw value."""
    golden = load(name)
    model, codes = golden.model, golden.codes.copy()
    rng = np.random.default_rng(71)
    raw = rng.integers(-(2**31), 2**31, size=(len(codes), len(model.outputs))).astype(np.int32)
    thermometer = codes[:, model.guards.temperature_channel]
    thermometer[thermometer == -32768] = -32767  # which stands for "not yet"
    thermometer[list(MISSING)] = -32768
    if name == "effects":
        last = replace(model.channels[3], source=f"measured:{model.outputs[1].name}")
        assert last.bits == 32
        model = replace(model, channels=(*model.channels[:3], last))
        codes[:, 3] = rng.integers(-(2**31), 2**31, size=len(codes))  # what must not be read
    return model, codes, raw


@needs_cantools
@pytest.mark.board
@pytest.mark.parametrize("name", ["front_end", "effects"])
def test_frames_of_the_firmware_equal_the_reference(name: str, tmp_path: Path) -> None:
    import can
    import cantools

    if shutil.which("qemu-system-arm") is None:
        pytest.skip("QEMU or the cross-compiler (cortex) is not there: make setup-qemu")
    model, codes, raw = draw_samples(name)
    elf = load_builder().build_image(model, codes, raw, tmp_path / "flash")
    log = tmp_path / "can.log"
    subprocess.run(
        ["qemu-system-arm", "-M", "mps2-an386", "-kernel", elf, "-nographic", "-monitor", "none",
         "-serial", f"file:{log}", "-semihosting-config", "enable=on,target=native"],
        check=True, timeout=600,
    )  # fmt: skip
    database = cantools.database.load_file(elf.with_suffix(".dbc"))
    frames = list(can.CanutilsLogReader(log))
    outputs = len(model.outputs)
    assert len(frames) == 2 * outputs * len(codes)
    seen = np.zeros((len(codes), outputs, 3), dtype=np.int64)
    flags = np.zeros((len(codes), outputs), dtype=np.int64)
    for i, frame in enumerate(frames):
        step, place = divmod(i, 2 * outputs)
        k, second = divmod(place, 2)
        values = database.decode_message(frame.arbitration_id, frame.data, scaling=False)
        assert isinstance(values, dict)
        if second:
            seen[step, k, 2], flags[step, k] = values["Compensated"], values["Flags"]
            assert values["Counter"] == step
        else:
            seen[step, k, :2] = values["Raw"], values["Drift"]

    read = np.setdiff1d(np.arange(len(codes)), MISSING)
    if name == "effects":
        codes[:, 3] = raw[:, 1]
    expected = Reference(model).run(codes[read][None], settled=True)
    drift = np.zeros((len(codes), outputs), dtype=np.int64)
    drift[read] = expected.drift[0]
    told = np.full(len(codes), FLAG_THERMOMETER)
    told[read] = expected.flags[0]
    np.testing.assert_array_equal(seen[:, :, 0], raw)
    np.testing.assert_array_equal(seen[:, :, 1], drift)
    compensated = np.clip(raw.astype(np.int64) - drift, -(2**31), 2**31 - 1)
    np.testing.assert_array_equal(seen[:, :, 2], compensated)
    np.testing.assert_array_equal(flags, np.repeat(told[:, None], outputs, axis=1))
    assert elf.with_suffix(".bin").stat().st_size > 4000


def test_missing_cantools_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    builder = load_builder()
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(Exception, match="pip install cantools"):
        builder.write_can(load("front_end").model, tmp_path)
