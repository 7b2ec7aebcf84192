"""The tutorials say what the commands print."""

import importlib.util
import shlex
from pathlib import Path

import click
import pytest

from zerodrift.cli.main import cli

_SPEC = importlib.util.spec_from_file_location(
    "regenerate_tutorial", Path(__file__).with_name("regenerate_tutorial.py")
)
assert _SPEC is not None
assert _SPEC.loader is not None
tutorial = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(tutorial)

PAGES = tutorial.list_pages()


def check_page(path):
    page = path.read_text(encoding="utf-8")
    missing = tutorial.list_missing_data(page)
    if missing:
        pytest.skip(f"third-party data is not here: {tutorial.DATA / missing[0]}")

    def visit(step, output):
        difference = tutorial.explain_difference(step.output, output)
        assert not difference, (
            f"{path.name}: $ {step.command}: {difference}. If that is as it should be, run "
            f"tests/loop/regenerate_tutorial.py and read the diff.\n{output}"
        )

    tutorial.walk_page(page, visit)


def test_there_are_tutorials_on_simulated_and_on_real_logs():
    assert [path.stem for path in PAGES] == [
        "real-resistor",
        "real-thin-evidence",
        "simulated-sensor",
    ]


@pytest.mark.slow
def test_resistor_tutorial_prints_what_it_says():
    check_page(next(path for path in PAGES if path.stem == "real-resistor"))


@pytest.mark.slow
def test_tutorial_on_thin_evidence_prints_what_it_says():
    check_page(next(path for path in PAGES if path.stem == "real-thin-evidence"))


@pytest.mark.slow
def test_simulated_tutorial_prints_what_it_says():
    check_page(next(path for path in PAGES if path.stem == "simulated-sensor"))


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_tutorial_names_only_commands_and_options_that_there_are(path):
    steps = [
        step
        for block in tutorial.list_blocks(path.read_text(encoding="utf-8"))
        for step in tutorial.split_steps(block)
    ]
    assert steps
    for step in steps:
        words = shlex.split(step.command)
        if words[0] != "zerodrift":
            continue
        command = cli.get_command(click.Context(cli), words[1])
        assert command is not None, step.command
        known = {name for parameter in command.params for name in parameter.opts}
        assert {word for word in words[2:] if word.startswith("-")} <= known, step.command


@pytest.mark.parametrize(
    ("expected", "found", "same"),
    [
        ("Fz 1.283 ppm", "Fz  1.284 ppm", True),
        ("Fz 1.283 ppm", "Fz 1.383 ppm", False),
        ("MISSING: thermal_lag", "MISSING: creep", False),
        ("tau_s = 206.8 s.", "tau_s = 206.7 s.", True),
        ("│████▍ 2.76 x", "│████▌ 2.76 x", True),
        ("one two", "one two three", False),
    ],
)
def test_outputs_agree_in_words_and_nearly_in_figures(expected, found, same):
    assert (tutorial.explain_difference(expected, found) == "") is same


def test_block_is_split_into_commands_and_outputs():
    steps = tutorial.split_steps("$ one\na\nb\n$ two\n$ three\nc\n")
    assert [(s.command, s.output) for s in steps] == [
        ("one", "a\nb\n"),
        ("two", ""),
        ("three", "c\n"),
    ]
