"""A project of an earlier day, with firmware and a saved state of it: it has to open for ever.

Its logs are SIMULATED. `make_stored.py` says how it was made; it is not made again.
"""

import ctypes
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Result
from zerodrift.c_runtime.compilers import find_compiler
from zerodrift.export.golden import load_golden

pytestmark = pytest.mark.long

STORED = Path(__file__).parent / "stored"
Command = Callable[..., Result]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    place = tmp_path / "project"
    shutil.copytree(STORED, place)
    return place


def test_it_compares_and_its_history_is_read(project: Path, zerodrift: Command) -> None:
    done = zerodrift("compare", "-C", project, "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["outputs"]["Fz"]["rmse"] < told["outputs"]["Fz"]["rmse_uncompensated"]
    steps = json.loads(zerodrift("history", "-C", project, "--json").out)["steps"]
    assert "dark_current" in steps[-1]["effects"]


def test_its_firmware_is_verified_as_it_lies(project: Path, zerodrift: Command) -> None:
    before = {p: p.read_bytes() for p in (project / "firmware").iterdir()}
    done = zerodrift("verify", "-C", project, "--trust")
    assert done.code == 0, done.err
    assert {p: p.read_bytes() for p in (project / "firmware").iterdir()} == before


def test_its_saved_state_goes_on_in_its_own_firmware(project: Path, tmp_path: Path) -> None:
    """By the C that lies there: the state of an update over the air must not be lost."""
    firmware = project / "firmware"
    library = tmp_path / "stored.so"
    sources = [str(path) for path in firmware.glob("*.c")]
    options = ["-shared", "-fPIC", f"-I{firmware}", *sources, "-o", str(library)]
    find_compiler().run(options)
    code = ctypes.CDLL(str(library))
    golden = load_golden(project / "build" / "golden.npz")
    state = ctypes.create_string_buffer(4096)
    saved = (project / "saved_state.bin").read_bytes()
    code.stored_restore.restype = ctypes.c_uint32
    assert code.stored_restore(state, saved) == 0
    expected = np.loadtxt(project / "drift_after.txt", dtype=np.int64)
    half = len(golden.codes) // 2
    drift = (ctypes.c_int32 * 1)()
    for codes, wanted in zip(golden.codes[half:], expected, strict=True):
        given = np.ascontiguousarray(codes)
        code.stored_step(state, ctypes.c_void_p(given.ctypes.data), drift)
        assert drift[0] == wanted
    damaged = bytearray(saved)
    damaged[len(damaged) // 2] ^= 1
    assert code.stored_restore(state, bytes(damaged)) != 0


def test_it_goes_on(project: Path, zerodrift: Command) -> None:
    done = zerodrift("firmware", "-C", project)
    assert done.code == 0, done.err
    assert zerodrift("verify", "-C", project).code == 0
    assert zerodrift("remove", "dark_current", "-C", project).code == 0
    steps = json.loads(zerodrift("history", "-C", project, "--json").out)["steps"]
    assert steps[-1]["step"] == "- dark_current"
