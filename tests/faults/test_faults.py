"""Commands with faults at their calls: nothing mixed, one message, and the next command works."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.faults.scenarios import SCENARIOS

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]


def run_faults(*arguments: str) -> None:
    command = [sys.executable, "-m", "tests.faults", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    assert " points tried" in done.stdout


def test_init_stands_a_fifth_of_its_faults() -> None:
    run_faults("init", "--share", "0.2", "--drawn", "24")


@pytest.mark.slow
@pytest.mark.parametrize("name", [scenario.name for scenario in SCENARIOS])
def test_every_fault_of_every_command(name: str) -> None:
    run_faults(name)
