"""The staircase: steps, steps by hand, and the picture."""

import json

import pytest
from click.testing import CliRunner

from zerodrift.base.config import load_config
from zerodrift.cli.history import draw_bar
from zerodrift.cli.main import cli
from zerodrift.diagnosis.history import (
    EffectSettings,
    Entry,
    Stored,
    list_steps,
    load_history,
    render_history,
)


def make_entry(action, effect, before, after, effects_before, effects, **more):
    return Entry(
        action=action,
        effect=effect,
        effects=tuple(effects),
        before=Stored({"Fz": before}),
        after=Stored({"Fz": after}),
        noise_floor={"Fz": 1.0},
        noise_floor_source="dwell",
        units={"Fz": "N"},
        held_out="test logs",
        helps=True,
        reason="because",
        effects_before=tuple(effects_before),
        **{"tared": False, **more},
    )


def test_steps_begin_with_the_start_and_follow_the_changes():
    steps = list_steps(
        [
            make_entry("add", "b", 8.0, 4.0, ["a"], ["a", "b"]),
            make_entry("add", "c", 4.0, 2.0, ["a", "b"], ["a", "b", "c"]),
            make_entry("remove", "b", 2.0, 3.0, ["a", "b", "c"], ["a", "c"]),
        ]
    )
    assert [step.label for step in steps] == ["start", "+ b", "+ c", "- b"]
    assert [step.errors["Fz"] for step in steps] == [8.0, 4.0, 2.0, 3.0]
    assert steps[-1].effects == ("a", "c")


def test_edit_by_hand_is_a_step_of_its_own():
    steps = list_steps(
        [
            make_entry("add", "b", 8.0, 4.0, ["a"], ["a", "b"]),
            make_entry("add", "c", 5.0, 2.0, ["b"], ["b", "c"]),
        ]
    )
    assert [step.label for step in steps] == ["start", "+ b", "by hand", "+ c"]
    assert steps[2].errors == {"Fz": 5.0}
    assert "edited" in steps[2].reason


def test_other_logs_are_a_step_of_their_own():
    steps = list_steps(
        [
            make_entry("add", "b", 8.0, 4.0, ["a"], ["a", "b"]),
            make_entry("add", "c", 6.0, 2.0, ["a", "b"], ["a", "b", "c"]),
        ]
    )
    assert steps[2].label == "by hand"
    assert "logs" in steps[2].reason


def test_history_is_read_as_it_was_written(tmp_path):
    entries = (make_entry("add", "b", 8.0, 4.0, ["a"], ["a", "b"], tared=True),)
    path = tmp_path / "history.json"
    path.write_bytes(render_history(entries))
    assert load_history(path) == entries


def test_ratio_is_the_root_mean_square_over_outputs_with_a_floor():
    step = list_steps([make_entry("add", "b", 8.0, 4.0, ["a"], ["a", "b"])])[1]
    assert step.ratio() == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("ratio", "bar"), [(1.0, ""), (0.9, ""), (16.0, "████"), (4.0, "██"), (2.0, "█")]
)
def test_bar_is_logarithmic_from_the_floor(ratio, bar):
    assert draw_bar(ratio, 16.0, width=4) == bar


def test_command_shows_table_bars_and_reasons(project, zerodrift):
    zerodrift("add", "thermal_lag", "-C", project.directory)
    out = zerodrift("history", "-C", project.directory).out
    for words in ("start", "+ thermal_lag", "█", "x floor", "falls in 5 of 5 runs", "Fz N"):
        assert words in out
    told = json.loads(zerodrift("history", "-C", project.directory, "--json").out)
    assert [step["step"] for step in told["steps"]] == ["start", "+ thermal_lag"]
    assert told["steps"][1]["ratio_to_floor"] < 1.1


def test_command_without_a_history_says_how_to_begin_one(project, zerodrift):
    result = zerodrift("history", "-C", project.directory)
    assert result.code == 0
    assert "zerodrift add" in result.out
    told = json.loads(zerodrift("history", "-C", project.directory, "--json").out)
    assert told == {"schema": "history/1", "steps": []}


def test_page_stands_alone_and_is_the_same_every_time(project, zerodrift, tmp_path):
    zerodrift("add", "thermal_lag", "-C", project.directory)
    pages = []
    for name in ("one.html", "two.html"):
        zerodrift("history", "-C", project.directory, "--html", tmp_path / name)
        pages.append((tmp_path / name).read_text(encoding="utf-8"))
    assert pages[0] == pages[1]
    assert 'src="http' not in pages[0]
    assert "thermal_lag" in pages[0]


def settings(*kinds):
    return tuple(EffectSettings(kind, {"tau_s": 60.0} if kind == "b" else {}) for kind in kinds)


@pytest.fixture
def staircase(tmp_path):
    """A project whose effects went a -> a, b -> a, b, c, with the history of it."""
    (tmp_path / "zerodrift.toml").write_text(
        '[sensor]\nname = "s"\ntime = "t"\ntemperature = "T"\nsample_period_s = 1.0  # as logged\n'
        "\n"
        '[outputs.y]\nmeasured = "y"\nunit = "N"\nfull_scale = 1.0\n\n'
        '[logs]\ntrain = ["a.csv"]\n\n[[effect]]\nkind = "a"\n\n'
        '[[effect]]\nkind = "b"\ntau_s = 60.0\n\n[[effect]]\nkind = "c"\n'
    )
    entries = [
        make_entry(
            "add", "b", 8.0, 4.0, ["a"], ["a", "b"],
            settings_before=settings("a"), settings=settings("a", "b"),
        ),
        make_entry(
            "add", "c", 4.0, 2.0, ["a", "b"], ["a", "b", "c"],
            settings_before=settings("a", "b"), settings=settings("a", "b", "c"),
        ),
    ]  # fmt: skip
    (tmp_path / "build").mkdir()
    (tmp_path / "build/history.json").write_bytes(render_history(entries))
    return tmp_path


def restore(project, number):
    return CliRunner().invoke(cli, ["history", "-C", str(project), "--restore", str(number)])


def test_a_step_is_restored_with_its_values_and_can_be_left_again(staircase):
    whole = load_config(staircase).effects
    assert restore(staircase, 1).exit_code == 0
    (a, b) = load_config(staircase).effects
    assert (a.kind, b.kind, b.held) == ("a", "b", {"tau_s": 60.0})
    assert "# as logged" in (staircase / "zerodrift.toml").read_text()
    steps = list_steps(load_history(staircase / "build/history.json"))
    assert [step.label for step in steps] == ["start", "+ b", "+ c", "as step 1"]
    assert steps[-1].errors == {"Fz": 4.0}
    assert restore(staircase, 2).exit_code == 0
    again = load_config(staircase).effects
    assert [(e.kind, e.held) for e in again] == [(e.kind, e.held) for e in whole]


def test_restoring_what_is_there_writes_nothing(staircase):
    files = (staircase / "zerodrift.toml", staircase / "build/history.json")
    before = [path.read_bytes() for path in files]
    done = restore(staircase, 2)
    assert done.exit_code == 0 and "already; nothing was written" in done.stderr
    assert [path.read_bytes() for path in files] == before


def test_a_step_that_is_not_there_or_kept_nothing_is_refused(staircase):
    text = (staircase / "zerodrift.toml").read_text()
    assert "steps 0 to 2" in str(restore(staircase, 7).exception)
    old = make_entry("add", "b", 8.0, 4.0, ["a"], ["a", "b"])
    (staircase / "build/history.json").write_bytes(render_history([old]))
    assert "kept no settings" in str(restore(staircase, 1).exception)
    assert (staircase / "zerodrift.toml").read_text() == text
