"""Where a command runs must not matter: no home, odd paths, odd streams, little memory."""

import json
import os
import sys
from pathlib import Path

import pytest
from benchmarks.bench_memory import write_project as write_long_project
from tests.surroundings.conftest import (
    OUTPUT,
    REST,
    Command,
    Run,
    assert_one_message,
    write_project,
)

from zerodrift.base.lock import make_scratch
from zerodrift.cli.main import is_out_of_memory

needs_posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX only")
ODD_NAMES = ["a%b", "tab\tb", "new\nline", 'quote"b', "back\\slash", "a'b", "dollar$b", "ä b"]


@pytest.mark.long
@needs_posix
def test_firmware_is_built_without_a_home(project: Path, run: Run) -> None:
    done = run("firmware", "-C", project, without=("HOME", "XDG_CACHE_HOME"))
    assert done.returncode == 0, done.stderr
    assert (project / "firmware/small.c").is_file()


@pytest.mark.long
@needs_posix
@pytest.mark.parametrize(
    "name", [ODD_NAMES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in ODD_NAMES[1:])]
)
def test_firmware_is_built_below_an_odd_path(name: str, tmp_path: Path, run: Run) -> None:
    project = write_project(tmp_path / name)
    done = run("firmware", "-C", project)
    assert done.returncode == 0, done.stderr
    assert run("verify", "-C", project).returncode == 0


@needs_posix
@pytest.mark.parametrize("name", ODD_NAMES)
def test_compilers_work_in_folders_with_plain_names(name: str, tmp_path: Path) -> None:
    odd = tmp_path / name
    odd.mkdir()
    with make_scratch(odd) as scratch:
        assert not set("%\\\"'$\t\n") & set(str(scratch))
        assert scratch.is_dir()
    assert not list(odd.iterdir())


@pytest.mark.long
@needs_posix
def test_a_closed_stdout_is_no_error(project: Path, run: Run) -> None:
    done = run("compare", "-C", project, preexec_fn=lambda: __import__("os").close(1))
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
@needs_posix
def test_a_reader_that_has_gone_gets_no_message(project: Path, run: Run) -> None:
    """As in `zerodrift compare | head`."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = run("compare", "-C", project, capture_output=False, stdout=writer, stderr=-1)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


@pytest.mark.long
@needs_posix
def test_a_full_stdout_is_told_as_such(project: Path, run: Run) -> None:
    with Path("/dev/full").open("w") as full:
        done = run("compare", "-C", project, capture_output=False, stdout=full, stderr=-1)
    assert_one_message(done, 2, "standard output", "No space left")


@pytest.mark.long
def test_names_beyond_ascii_are_printed_on_an_ascii_terminal(tmp_path: Path, run: Run) -> None:
    project = write_project(tmp_path / "p", output=OUTPUT.replace("[outputs.y]", '[outputs."yä"]'))
    ascii_only = {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    shown = run("compare", "-C", project, environment=ascii_only)
    assert shown.returncode == 0, shown.stderr
    assert "y\\xe4" in shown.stdout
    found = run("compare", "-C", project, "--json", environment=ascii_only)
    assert list(json.loads(found.stdout)["outputs"]) == ["yä"]


@needs_posix
@pytest.mark.parametrize("limit_kB", [400_000, 850_000, 1_000_000, 1_200_000])
def test_too_little_memory_for_the_libraries_is_one_message(
    limit_kB: int, project: Path, run: Run
) -> None:
    """They abort, or wait for ever, when they are loaded in less."""
    done = run("compare", "-C", project, preexec_fn=lambda: limit_address_space(limit_kB))
    assert_one_message(done, 2, "GB of address space (ulimit -v)", "1.25 GB at least", "Raise")


@needs_posix
@pytest.mark.parametrize("command", ["effects", "doctor"])
def test_commands_that_read_no_log_load_the_libraries_too(command: str, run: Run) -> None:
    done = run(command, preexec_fn=lambda: limit_address_space(400_000))
    assert_one_message(done, 2, "1.25 GB at least")


@pytest.mark.long
@needs_posix
def test_help_needs_no_memory_to_speak_of(run: Run) -> None:
    done = run("compare", "--help", preexec_fn=lambda: limit_address_space(700_000))
    assert (done.returncode, "Usage:" in done.stdout) == (0, True), done.stderr


@needs_posix
@pytest.mark.spread(0, "limit_kB", [1_300_000, pytest.param(1_500_000, marks=pytest.mark.slow)])
def test_little_memory_is_told_before_a_library_gives_up(
    limit_kB: int, project: Path, run: Run
) -> None:
    done = run("compare", "-C", project, preexec_fn=lambda: limit_address_space(limit_kB))
    assert "GB of address space (ulimit -v)" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_library_that_finds_no_room_is_told_from_one_that_is_missing() -> None:
    assert is_out_of_memory(ImportError("x.so: failed to map segment from shared object"))
    assert is_out_of_memory(RuntimeError("can't start new thread"))
    assert not is_out_of_memory(ModuleNotFoundError("No module named 'torch'"))
    assert not is_out_of_memory(RuntimeError("another"))


def limit_address_space(limit_kB: int) -> None:
    """Limit what this process may address, as `ulimit -v` does."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (limit_kB * 1024, limit_kB * 1024))


@needs_posix
@pytest.mark.slow
def test_a_million_rows_within_two_gigabytes_give_a_result_or_one_message(
    tmp_path: Path, run: Run
) -> None:
    import resource

    write_long_project(tmp_path, 1_000_000)
    limit = (2_000_000_000, 2_000_000_000)
    done = run(
        *("compare", "--json", "-C", tmp_path),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, limit),
    )
    assert "Traceback" not in done.stderr
    if done.returncode == 0:
        assert json.loads(done.stdout)["outputs"]
    else:
        assert done.returncode == 2
        assert done.stderr.count("error: not enough memory") == 1


@pytest.mark.parametrize("command", ["compare", "train", "export", "firmware", "verify", "report"])
def test_a_file_in_the_place_of_build_is_named(
    command: str, project: Path, zerodrift: Command
) -> None:
    (project / "build").touch()
    assert_one_message(
        zerodrift(command, "-C", project), 2, "build: is a file", "Move the file away"
    )


def test_a_nul_in_a_path_is_refused_with_its_line(project: Path, zerodrift: Command) -> None:
    toml = project / "zerodrift.toml"
    toml.write_text(toml.read_text() + '\n[firmware]\nout = "a\\u0000b"\n', encoding="utf-8")
    assert_one_message(zerodrift("firmware", "-C", project), 2, "zerodrift.toml:", "NUL")


def test_a_trillion_starts_are_refused(tmp_path: Path, zerodrift: Command) -> None:
    rest = REST.replace('kind = "none"', 'kind = "gru"\nstarts = 1000000000000')
    project = write_project(tmp_path / "p", rest)
    assert_one_message(zerodrift("train", "-C", project), 2, "starts", "1 to 1000")


@pytest.mark.parametrize(
    "text", ["import sys; sys.exit(0)", "raise BaseException('x')", "raise GeneratorExit"]
)
def test_a_file_of_effects_cannot_end_a_command_in_silence(
    text: str, tmp_path: Path, zerodrift: Command
) -> None:
    project = write_project(tmp_path / "p", REST + '\n[plugins]\nfiles = ["own.py"]\n')
    (project / "own.py").write_text(text, encoding="utf-8")
    assert_one_message(zerodrift("firmware", "-C", project), 2, "own.py:1")
    assert not (project / "firmware").exists()


def test_a_sensor_cannot_take_the_fleets_own_names() -> None:
    from zerodrift.base.errors import InputError
    from zerodrift.fleet.sensors import configure_sensor

    for name in ("runtime", "Runtime", "report.json", "report.csv", "report.md"):
        with pytest.raises(InputError, match="files of its own"):
            configure_sensor(None, name)  # type: ignore[arg-type]  # refused before it is read


def test_pictures_of_a_project_named_by_a_relative_path(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from zerodrift.report import browser

    monkeypatch.chdir(tmp_path)
    seen: list[str] = []

    def pretend(arguments: list[str], made: Path) -> None:
        seen.extend(arguments)
        made.write_bytes(b"%PDF")

    monkeypatch.setattr(browser, "_run", pretend)
    browser.print_page("<p>", Path(project.name) / "report.pdf", Path(project.name))
    assert (project / "report.pdf").read_bytes() == b"%PDF"
    assert any(str(tmp_path) in argument for argument in seen)


def test_doctor_says_what_is_here(project: Path, zerodrift: Command) -> None:
    done = zerodrift("doctor", "-C", project, "--json")
    assert done.code == 0, done.err
    found = {item["name"]: item for item in json.loads(done.out)["items"]}
    assert found["unicorn"]["is_missing"] is False
    assert found["cortex-m4"]["state"].startswith("zig")
    assert "GB" in found["free on its disk"]["state"]


def test_doctor_names_strays(project: Path, zerodrift: Command) -> None:
    (project / "build/.firmware-gone").mkdir(parents=True)
    done = zerodrift("doctor", "-C", project)
    assert ".firmware-gone" in done.out
