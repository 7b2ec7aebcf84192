"""Commands compute on one thread, and no process is forked beside threads: both wait for ever."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.conftest import Result

from zerodrift.base.threads import BLAS

ROOT = Path(__file__).parents[2]


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


def test_no_process_is_forked_beside_threads() -> None:
    """A fork takes along locks whose threads are gone; Polars then waits for ever."""
    pool = r"ProcessPoolExecutor\((?![^()]*mp_context)"
    forks = re.compile(rf"multiprocessing\.(?:Pool|Process)\(|{pool}")
    names = ["git", "ls-files", "*.py"]
    files = subprocess.run(names, cwd=ROOT, check=True, capture_output=True, text=True)
    assert not [f for f in files.stdout.split() if forks.search((ROOT / f).read_text("utf-8"))]
