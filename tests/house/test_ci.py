"""CI fails where a step fails, runs the others all the same, and says what is not here."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from tests.house.test_order import ROOT

CI = ROOT / ".ci"


def run_steps(body: str, tmp_path: Path) -> tuple[int, dict[str, str], str]:
    """Run a script of steps; return its exit code, the table as name -> outcome, and its output."""
    script = tmp_path / "run"
    script.write_text(f". {CI / 'steps.sh'}\n{body}\nfinish\n", encoding="utf-8")
    done = subprocess.run(
        ["bash", "-u", "-o", "pipefail", script], capture_output=True, text=True, check=False
    )
    rows = re.findall(r"^ +\d+ s  (passed|FAILED|not here|not run) +(\S+)", done.stdout, re.M)
    return done.returncode, {name: outcome for outcome, name in rows}, done.stdout + done.stderr


def test_all_steps_that_pass_make_a_run_that_passes(tmp_path: Path) -> None:
    code, table, _ = run_steps("step one -- true\nstep two after one -- true", tmp_path)
    assert (code, table) == (0, {"one": "passed", "two": "passed"})


def test_a_step_that_fails_fails_the_run_and_stops_none_but_those_after_it(tmp_path: Path) -> None:
    body = "step one -- false\nstep two after one -- touch two\nstep three -- touch three"
    code, table, told = run_steps(body.replace("touch ", f"touch {tmp_path}/"), tmp_path)
    assert code == 1
    assert table == {"one": "FAILED", "two": "not run", "three": "passed"}
    assert "needs one" in told and "exit code 1" in told
    assert not (tmp_path / "two").exists() and (tmp_path / "three").exists()


def test_what_cannot_be_installed_is_not_here_and_no_failure(tmp_path: Path) -> None:
    body = "have tool -- false\nstep use after tool -- false\nstep other -- true"
    code, table, _ = run_steps(body, tmp_path)
    assert (code, table) == (0, {"tool": "not here", "use": "not here", "other": "passed"})


def test_a_step_that_hangs_or_whose_need_is_unknown_has_failed(tmp_path: Path) -> None:
    code, table, told = run_steps("step one within 1 -- sleep 60", tmp_path)
    assert (code, table) == (1, {"one": "FAILED"}) and "ended at its limit" in told
    assert run_steps("step one after nothing -- true", tmp_path)[:2] == (1, {"one": "not run"})


def test_a_step_beside_the_next_one_counts_as_any(tmp_path: Path) -> None:
    body = (
        "aside one -- bash -c 'while [ ! -e {0}/two ]; do sleep 0.01; done; echo told; exit 3'\n"
        "step two -- touch {0}/two\naside three -- true\nstep four after three -- true\n"
        "aside five after one -- true\nstep six after five -- true\naside seven -- false\n"
    )
    code, table, told = run_steps(body.format(tmp_path), tmp_path)
    assert code == 1 and "told" in told
    failed = {"one": "FAILED", "five": "not run", "six": "not run", "seven": "FAILED"}
    assert table == dict.fromkeys(("two", "three", "four"), "passed") | failed


@pytest.mark.parametrize("end", ["exit 0", "kill $$", "nonsense=$unset"])
def test_a_run_that_ends_early_has_failed(end: str, tmp_path: Path) -> None:
    code, table, told = run_steps(f"step one -- true\n{end}\nstep two -- true", tmp_path)
    assert code != 0 and table == {"one": "passed"} and "stopped before the last step" in told


def test_the_script_of_ci_hides_no_failure_and_tests_what_the_readme_tells() -> None:
    script = (CI / "run").read_text(encoding="utf-8")
    assert "||" not in script and "set +" not in script
    assert script.rstrip().endswith("finish")
    steps = re.findall(r"^(?:step|have|aside) (\S+) .*-- (.*)$", script, re.M)
    assert ("test", "make test") in steps and "make test" in (ROOT / "README.md").read_text("utf-8")
    known = {name for name, _ in steps}
    for needs in re.findall(r'^(?:step|have|aside) .*? after ("[^"]*"|\S+) ', script, re.M):
        assert set(needs.strip('"').split()) <= known
    targets = set(re.findall(r"^([a-z][a-z0-9-]*):", (ROOT / "Makefile").read_text("utf-8"), re.M))
    assert {
        target for _, command in steps for target in re.findall(r"make (\S+)", command)
    } <= targets


def test_lowest_versions_are_those_of_the_bounds() -> None:
    spec = importlib.util.spec_from_file_location("lowest", CI / "lowest.py")
    assert spec is not None and spec.loader is not None
    lowest = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(lowest)
    project = {
        "dependencies": ["numpy>=2.0"],
        "optional-dependencies": {"dev": ["fsspec[http]>=2024.6"], "no": ["scipy>1"]},
    }
    assert lowest.list_lowest(project, ["dev"]) == ["fsspec[http]==2024.6", "numpy==2.0"]
    with pytest.raises(ValueError, match="expected NAME>=VERSION"):
        lowest.list_lowest(project, ["no"])
    real = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert len(lowest.list_lowest(real, ["dev", "formats"])) > 20


@pytest.mark.parametrize("lock", sorted(ROOT.glob("requirements*.lock")), ids=lambda p: p.name)
def test_every_pinned_version_has_the_hashes_of_its_files(lock: Path) -> None:
    """But PyTorch's, whose file tells why."""
    text = lock.read_text(encoding="utf-8")
    assert "://" not in text
    entries = re.split(r"\n(?=[A-Za-z])", re.sub(r"^#.*\n", "", text, flags=re.M).strip())
    for entry in entries:
        pinned, *hashes = entry.split("\\\n")
        assert re.match(r"[\w.-]+==[\w.]+( ;.*)?$", pinned.strip()), pinned
        if not pinned.startswith("torch=="):
            assert hashes, f"{lock.name}: {pinned} has no hash. Run `make lock`."
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", one.strip()) for one in hashes)


@pytest.mark.parametrize("code", [0, 3])
def test_a_benchmark_that_misses_a_mark_fails_the_run(code: int, tmp_path: Path) -> None:
    (tmp_path / "bench_ci.py").write_text(f"def main(quick):\n    return {code}\n")
    program = (
        "import sys, benchmarks, benchmarks.__main__ as b\n"
        f"benchmarks.__path__.append({str(tmp_path)!r})\n"
        "sys.argv = ['benchmarks', 'bench_ci']\n"
        "sys.exit(b.main())\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=False)
    assert done.returncode == (code > 0)


def test_tiers_are_markers_that_are_registered_and_used_and_no_list_of_names() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["pytest"]
    assert "--strict-markers" in options["ini_options"]["addopts"].split()
    files = [p for p in (ROOT / "tests").rglob("*") if p.suffix in (".py", ".txt", ".toml", ".ini")]
    texts = {path: path.read_text("utf-8") for path in files}
    used = set(re.findall(r"pytest\.mark\.(\w+)", " ".join(texts.values())))
    own = {"parametrize", "skipif", "usefixtures", "filterwarnings"}
    registered = {re.match(r"\w+", line)[0] for line in options["ini_options"]["markers"]}
    assert used - own == registered
    assert not [str(path) for path, text in texts.items() if re.search(r"\.py::[a-z]", text)]


def test_spread_leaves_all_but_so_many_cases_to_test_long(tmp_path: Path) -> None:
    file = tmp_path / "test_it.py"
    cases = "[pytest.param(9, marks=pytest.mark.slow), *'abcdef']"
    file.write_text(f"import pytest\n@pytest.mark.spread(2, 'x', {cases})\ndef test_it(x): ...\n")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "tests.conftest",
        "-c",
        ROOT / "pyproject.toml",
    ]
    done = subprocess.run(
        [*command, "--collect-only", "-q", "-m", "not long", file],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert re.findall(r"test_it\[(.)\]", done.stdout) == ["9", "a", "d"], done.stdout
