"""The model checks itself: constants, saved states, damage; and fails toward the raw value."""

import re
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from platform import machine

import numpy as np
import pytest
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import GeneratedCode, generate
from zerodrift.export.integer_model import FLAG_DAMAGED

SHAPE = Shape(front_end=("lowpass", "delay"), hidden=6, inputs=2, outputs=2)
WINDOWED = Shape(window=3, hidden=4, inputs=2, outputs=1)
REPLAY, TABLES = 1, 2


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> HostModel:
    return build(SHAPE, tmp_path_factory.mktemp("self_check"))


def build(shape: Shape, folder: Path, seed: int = 61, flags: tuple[str, ...] = ()) -> HostModel:
    model = draw_model(shape, seed)
    return HostModel(model, generate(model), folder, flags=("-O1", *flags), observe=False)


@pytest.mark.parametrize("shape", [SHAPE, WINDOWED], ids=["stream", "window"])
def test_restored_state_goes_on_as_if_nothing_had_happened(shape: Shape, tmp_path: Path) -> None:
    host = build(shape, tmp_path)
    codes = Draw(1).codes(-32768, 32767, 60, shape.inputs)
    whole = host.run(codes)
    host.run(codes[:23])
    saved = host.save()
    host.run(codes[::-1])  # something else in between
    assert host.restore(saved) == 0
    rest = host.run(codes[23:], restart=False)
    np.testing.assert_array_equal(rest.drift, whole.drift[23:])
    np.testing.assert_array_equal(rest.flags, whole.flags[23:])


def test_copy_with_any_bit_flipped_is_refused_and_the_start_is_cold(host: HostModel) -> None:
    codes = Draw(2).codes(-32768, 32767, 30, SHAPE.inputs)
    cold = host.run(codes, settled=False)
    host.run(codes)
    saved = host.save()
    for bit in range(8 * len(saved)):
        damaged = bytearray(saved)
        damaged[bit // 8] ^= 1 << bit % 8
        assert host.restore(bytes(damaged)) == 1
        if bit % 97 == 0:
            after = host.run(codes, restart=False)
            np.testing.assert_array_equal(after.drift, cold.drift)
            np.testing.assert_array_equal(after.flags, cold.flags)
    assert host.restore(saved) == 0


def test_copy_of_another_model_version_or_nonsense_with_a_good_crc_is_refused(
    host: HostModel, tmp_path: Path
) -> None:
    other = build(replace(SHAPE, gain=2.0), tmp_path)
    assert other.state_bytes == host.state_bytes
    other.run(Draw(3).codes(-32768, 32767, 5, SHAPE.inputs))
    assert host.restore(other.save()) == 1
    host.run(Draw(3).codes(-32768, 32767, 5, SHAPE.inputs))
    saved = host.save()
    newer = struct.pack("<I", 2) + saved[4:-4]
    assert host.restore(newer + struct.pack("<I", zlib.crc32(newer))) == 1
    full = saved[:16] + b"\x7f" * (len(saved) - 20)  # header and model's identity are right
    assert host.restore(full + struct.pack("<I", zlib.crc32(full))) == 1
    assert host.restore(saved) == 0


def test_damaged_state_gives_the_raw_value(host: HostModel) -> None:
    codes = Draw(4).codes(-3000, 3000, 4, SHAPE.inputs)
    host.run(codes)
    host._state[0] = bytes([host._state.raw[0] ^ 1])  # the identity
    trace = host.run(codes, restart=False)
    assert trace.flags[0] == FLAG_DAMAGED and not trace.drift[0].any()
    assert not trace.flags[1:].max() & FLAG_DAMAGED


def damage(code: GeneratedCode, array: str) -> GeneratedCode:
    """Return the code with the last number of every array of that name changed by one."""
    changed, count = re.subn(
        rf"({array}\[\d+\] = \{{.*?)(-?\d+)(\n\}};)",
        lambda m: f"{m[1]}{int(m[2]) ^ 1}{m[3]}",
        code.source,
        flags=re.DOTALL,
    )
    assert count >= 1
    return replace(code, source=changed)


PORTABLE = (("-DZD_KERNEL=0",), ("-DZD_SMALL", "-DZD_KERNEL=0"))
STREAMED = (("-DZD_KERNEL=1",), ("-DZD_SMALL", "-DZD_KERNEL=1"))
STREAMED += (("-DZD_KERNEL=3",), ("-mavx2",)) if machine() in ("x86_64", "AMD64") else ()


@pytest.mark.parametrize("flags", PORTABLE + STREAMED, ids=" ".join)
@pytest.mark.spread(2, "array", ["w_h", "stream", "weights"])
def test_selftest_tells_damaged_weights(array: str, flags: tuple[str, ...], tmp_path: Path) -> None:
    if (array == "stream" and flags in PORTABLE) or (array == "w_h" and flags in STREAMED):
        pytest.skip("not an array of this kernel")
    if flags == ("-mavx2",) and "avx2" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this processor has no AVX2")
    model = draw_model(SHAPE, 63)
    code = generate(model)
    told = [
        HostModel(model, text, tmp_path, flags=("-O1", *flags)).selftest()
        for text in (code, damage(code, array))
    ]
    assert told[0] == 0 and told[1] & TABLES


@pytest.mark.parametrize("weights", ["int16", "int8"])
@pytest.mark.parametrize("reset", ["before", "after"])
def test_selftest_passes_in_every_form(weights: str, reset: str, tmp_path: Path) -> None:
    assert build(replace(SHAPE, weights=weights, reset=reset), tmp_path).selftest() == 0
