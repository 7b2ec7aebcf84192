"""Commands compute on one thread: with two on a busy machine, threads wait for each other."""

import os
import subprocess
import sys
from collections.abc import Callable

import pytest
from tests.conftest import Result

from zerodrift.base.threads import BLAS


def test_commands_compute_on_one_thread_unless_the_user_wants_more(
    zerodrift: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in BLAS[1:]:
        monkeypatch.setenv(name, "")  # restored afterwards
        monkeypatch.delenv(name)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    zerodrift("--version")
    assert [os.environ[name] for name in BLAS] == ["3", "1", "1"]


def test_number_of_threads_is_set_before_numpy_is_loaded() -> None:
    code = "import sys, zerodrift.cli.main; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
