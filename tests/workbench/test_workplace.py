"""What the page does to a project is what the command line does, and it can be taken back."""

import json
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from zerodrift.base.records import from_json
from zerodrift.diagnosis.history import find_timeline
from zerodrift.report.results import AddResult
from zerodrift.tasks.trust import claim
from zerodrift.verify.summary import LogsRefused
from zerodrift.workbench.views import show_outcome
from zerodrift.workbench.workplace import Workplace

pytestmark = pytest.mark.long


@pytest.fixture
def place(project):
    workplace = Workplace(project.directory)
    yield workplace
    workplace.close()


def settle(place, timeout_s=600.0):
    """Wait until nothing runs, a survey that follows a command included.

    The limit is there for a command that hangs, not for a slow machine.
    """
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        job = place.job
        if job is not None:
            job.wait(timeout_s)
        if job is place.job:
            return
        time.sleep(0.02)
    raise AssertionError("still busy")


def run_command(directory, *arguments):
    done = subprocess.run(
        [sys.executable, "-m", "zerodrift", *arguments, "-C", str(directory)],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, json.loads(done.stdout)


def test_add_does_what_the_command_does_and_undo_takes_it_back(place, project, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(project.directory, copy)
    before = project.toml.read_bytes()
    place.look()
    settle(place)
    assert place.findings.diagnosed.diagnosis.effect == "thermal_lag"
    assert "thermal_lag" in place.previews
    place.run("add", "Adding thermal_lag", ["add", "thermal_lag", "--json"])
    settle(place)
    _, told = run_command(copy, "add", "thermal_lag", "--json")
    assert place.revision == from_json(AddResult, told)
    assert told["after"]["rmse_heldout"]["Fz"] < told["before"]["rmse_heldout"]["Fz"]
    assert project.toml.read_bytes() == (copy / "zerodrift.toml").read_bytes()
    assert project.history.read_bytes() == (copy / "build" / "history.json").read_bytes()
    assert place.findings.steps[-1].label == "+ thermal_lag"
    place.undo()
    settle(place)
    assert project.toml.read_bytes() == before
    assert place.findings.comparison.effects == ("zero_tempco",)
    place.close()
    later = Workplace(project.directory)
    later.look()
    settle(later)
    assert find_timeline(later.findings.steps).redo == 1
    later.redo()
    settle(later)
    assert project.toml.read_bytes() == (copy / "zerodrift.toml").read_bytes()
    assert [s.label for s in later.findings.steps] == [
        *("start", "+ thermal_lag", "as step 0", "as step 1")
    ]
    later.close()


@pytest.mark.slow
def test_undo_keeps_what_else_was_edited_and_refuses_other_effects(place, project):
    place.run("add", "Adding thermal_lag", ["add", "thermal_lag", "--json"])
    settle(place)
    project.toml.write_text(project.toml.read_text() + "# mine\n")
    place.poll()
    settle(place)
    place.undo()
    settle(place)
    assert "# mine" in project.toml.read_text()
    assert "thermal_lag" not in project.toml.read_text()
    edited = project.toml.read_text() + '[[effect]]\nkind = "ageing"\n'
    project.toml.write_text(edited)
    place.redo()
    settle(place)
    assert project.toml.read_text() == edited
    assert "was edited since" in place.message.text


@pytest.mark.slow
def test_effect_that_does_not_help_is_told_and_not_kept(place, project):
    before = project.toml.read_bytes()
    place.run("add", "Adding ageing", ["add", "ageing", "--json"])
    settle(place)
    assert project.toml.read_bytes() == before
    assert "was not added" in place.message.text
    assert place.refused == {"ageing": place.revision.reason}


def test_refused_logs_are_told_and_are_no_change_from_outside(place, project):
    log = project.directory / "logs" / "run_2.csv"
    columns = np.loadtxt(log, delimiter=",", skiprows=1)
    columns[:, 1] = 1.8 * columns[:, 1] + 32.0
    head = log.read_text("utf-8").partition("\n")[0]
    np.savetxt(log, columns, fmt="%.5f", delimiter=",", header=head, comments="")
    place.run("firmware", "Building firmware", ["firmware", "--json"])
    settle(place)
    assert isinstance(place.outcome, LogsRefused)
    told = str(show_outcome(place.outcome))
    assert "looks like degF, not degC" in told and '[logs] accept = ["run_2: fahrenheit"]' in told
    place.poll()
    assert not place.busy and place.message is None


@pytest.mark.slow
def test_edit_from_outside_shows_up(place, project):
    place.look()
    settle(place)
    place.poll()
    assert not place.busy
    text = project.toml.read_text()
    project.toml.write_text(text.replace('kind = "zero_tempco"', 'kind = "dark_current"', 1))
    place.poll()
    assert "zerodrift.toml changed outside" in place.message.text
    settle(place)
    assert place.findings.comparison.effects == ("dark_current",)


@pytest.mark.slow
def test_log_deleted_under_it_is_told_and_the_findings_stay(place, project):
    place.look()
    settle(place)
    shutil.rmtree(project.directory / "logs")
    place.poll()
    settle(place)
    assert place.message.is_error
    assert "logs/run_*.csv" in place.message.text
    assert "Traceback" not in place.message.text
    assert place.findings.comparison.effects == ("zero_tempco",)
    project.toml.unlink()
    place.poll()
    assert "zerodrift.toml: is gone" in place.message.text
    assert place.findings.comparison.effects == ("zero_tempco",)
    assert place.run("add", "Adding creep", ["add", "creep", "--json"])
    settle(place)
    assert place.message.is_error
    assert "zerodrift.toml" in place.message.text
    version = place.version
    place.poll()
    assert place.version == version


EFFECT = """
from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature
{extra}
def build(ops, signals, p):
    {body}
register(Effect(kind="mine", title="mine", build=build, needs=("temperature",)))
"""


def use_effect(project, body, extra=""):
    (project.directory / "mine.py").write_text(EFFECT.format(body=body, extra=extra))
    project.toml.write_text(project.toml.read_text() + '\n[plugins]\nfiles = ["mine.py"]\n')
    claim(project.directory)


@pytest.mark.slow
def test_failing_effect_of_the_user_is_a_message(place, project):
    use_effect(project, "raise ZeroDivisionError('mine')")
    place.look()
    settle(place)
    place.run("add", "Adding mine", ["add", "mine", "--json"])
    settle(place)
    assert "mine" in place.message.text
    assert place.message.is_error


def test_what_never_ends_can_be_cancelled_and_leaves_the_project_as_it_was(place, project):
    use_effect(project, "return ()", extra="import time\ntime.sleep(600)")
    before = project.read_all()
    place.run("add", "Adding mine", ["add", "mine", "--json"])
    time.sleep(1.0)
    assert place.busy
    place.cancel()
    settle(place)
    assert "cancelled" in place.message.text
    assert project.read_all() == before


@pytest.mark.slow
def test_file_named_like_a_package_in_the_project_is_not_run(place, project):
    (project.directory / "numpy.py").write_text("raise SystemExit('hijacked')")
    place.look()
    settle(place)
    assert place.message is None
    assert place.findings is not None


@pytest.mark.slow
def test_read_only_configuration_is_a_message(place, project):
    project.toml.chmod(0o444)
    before = project.read_all()
    place.run("add", "Adding thermal_lag", ["add", "thermal_lag", "--json"])
    settle(place)
    assert "read-only" in place.message.text
    assert project.read_all() == before


@contextmanager
def let_no_file_grow():
    """Let every write to a file fail in what is started here, as on a full disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
def test_full_disk_is_a_message_and_nothing_is_half_written(place, project):
    before = project.read_all()
    with let_no_file_grow():
        place.run("add", "Adding thermal_lag", ["add", "thermal_lag", "--json"])
    settle(place)
    assert place.message.is_error
    assert "cannot be written (File too large)" in place.message.text
    assert "nobody foresaw" not in place.message.text
    assert project.read_all() == before
    with let_no_file_grow():
        place.look()
    settle(place)
    assert place.message.is_error
    assert "nobody foresaw" not in place.message.text
    assert place.findings is None
    assert project.read_all() == before
    place.look()
    settle(place)
    assert place.findings.diagnosed.diagnosis.effect == "thermal_lag"


@pytest.mark.slow
def test_invalid_rows_are_dropped_where_that_was_asked(project):
    log = project.directory / "logs" / "run_0.csv"
    lines = log.read_text().splitlines()
    lines[40] = lines[40].replace(lines[40].split(",")[1], "-256", 1)
    log.write_text("\n".join(lines) + "\n")
    for skip_invalid in (False, True):
        workplace = Workplace(project.directory, skip_invalid=skip_invalid)
        try:
            workplace.look()
            settle(workplace)
            assert (workplace.findings is not None) == skip_invalid
            if not skip_invalid:
                assert "run_0.csv:41: " in workplace.message.text
                continue
            assert any("run_0.csv" in note for note in workplace.findings.notes)
            workplace.run("add", "Adding thermal_lag", ["add", "thermal_lag", "--json"])
            settle(workplace)
            assert workplace.revision.added
        finally:
            workplace.close()


@pytest.mark.slow
def test_earlier_findings_are_taken_off_the_disk(place):
    for _ in range(3):
        place.look()
        settle(place)
    (kept,) = Path(place._scratch.name).iterdir()
    assert kept == place._result


@pytest.mark.slow
def test_second_command_waits_its_turn(place, project):
    use_effect(project, "return ()", extra="import time\ntime.sleep(600)")
    assert place.run("add", "Adding mine", ["add", "mine", "--json"])
    assert not place.run("remove", "Removing", ["remove", "zero_tempco", "--json"])
    assert "being done already" in place.message.text
    place.cancel()
    settle(place)
