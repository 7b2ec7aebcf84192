"""The list of tests that take longest names tests that there are."""

import re
import subprocess
import sys
from pathlib import Path

from tests.conftest import LONG

ROOT = Path(__file__).parents[2]


def test_every_long_test_is_there() -> None:
    texts: dict[str, str] = {}
    for name in LONG:
        file, _, function = name.partition("[")[0].partition("::")
        if file not in texts:
            texts[file] = (ROOT / file).read_text(encoding="utf-8")
        assert f"def {function.rpartition('::')[2]}(" in texts[file], name


def test_every_long_test_is_collected() -> None:
    """A parameter that has another name by now would bring a long test back into `make test`."""
    files = sorted({name.partition("::")[0] for name in LONG})
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run([*command, *files], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    collected = set(done.stdout.splitlines())
    # a file whose library is missing is skipped whole; a compiler that is missing has no cases
    there = {name.partition("::")[0] for name in collected}
    left = {name for name in LONG - collected if name.partition("::")[0] in there}
    assert not {name for name in left if not re.search(r"[\[-](gcc|clang)[\]-]", name)}


def test_the_list_is_sorted_and_leaves_the_main_job_to_make_test() -> None:
    lines = (ROOT / "tests" / "long.txt").read_text(encoding="utf-8").splitlines()
    assert lines == sorted(set(lines))
    assert not any(line.startswith("tests/main_job/") for line in lines)
