"""The staircase: steps, steps by hand, and the picture."""

import json

import pytest

from zerodrift.app.commands.history import draw_bar
from zerodrift.diagnosis.history import Entry, Stored, list_steps, load_history, render_history


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
