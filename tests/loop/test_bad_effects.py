"""A user's own effect that fails: file, line and reason; exit code 2; nothing written."""

import pytest

from zerodrift.physics.catalogue import load_catalogue

HEAD = """\
import numpy as np
from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature


def build(ops, signals, p):
    t = signals.temperature_degC
"""
TAIL = """

register(Effect(kind="mine", title="my own", build=build, needs=("temperature",)))
"""

FAILURES = {
    "raise ValueError('no such thing')": ("own.py:8", "raised ValueError: no such thing"),
    "raise SystemExit(3)": ("own.py:8", "raised SystemExit"),
    "return build(ops, signals, p)": ("own.py:8", "raised RecursionError"),
    "return [Feature('x', signals.channels['nought'])]": ("own.py:8", "KeyError: 'nought'"),
    "return [Feature('x', np.sin(t))]": ("own.py:8", "raised TypeError", "combined by `ops`"),
    "return [Feature('x', t + 1)]": ("own.py:8", "raised TypeError", "combined by `ops`"),
    "return [Feature('x', ops.affine(t, 0.0, float('nan')))]": ("feature 'x'", "NaN or infinite"),
    "return [Feature('x', ops.affine(t, 1e308, 1e308))]": ("feature 'x'", "NaN or infinite"),
    "return [Feature('x', np.zeros(5))]": ("feature 'x' is a ndarray", "operation of `ops`"),
    "return [Feature('x', 3.0)]": ("feature 'x' is a float", "operation of `ops`"),
    "return None": ("build returned NoneType", "expected a list of Feature"),
    "return Feature('x', t)": ("build returned Feature", "expected a list of Feature"),
    "return [t]": ("build returned a Node", "Feature(name, signal) was expected"),
    "return [Feature('x', t, output='Fy')]": ("for output 'Fy'", "The outputs are: Fz, Mx"),
}


@pytest.mark.parametrize("body", FAILURES)
def test_an_effect_that_fails_is_refused_by_name(make_project, zerodrift, body):
    project = make_project(runs=2, dwell=False)
    (project.directory / "own.py").write_text(f"{HEAD}    {body}{TAIL}")
    text = project.toml.read_text()
    plugin = '[plugins]\nfiles = ["own.py"]\n\n[network]'
    table = '[[effect]]\nkind = "mine"\n\n'
    commands = {
        ("add", "mine"): plugin,
        ("compare",): table + plugin,
        ("diagnose",): table + plugin,
        ("add", "thermal_lag"): table + plugin,
    }
    for command, tables in commands.items():
        project.toml.write_text(text.replace("[network]", tables))
        before = project.read_all()
        result = zerodrift(*command, "-C", project.directory)
        assert result.code == 2, result.out
        assert "own.py" in result.err
        assert "effect 'mine'" in result.err
        for words in FAILURES[body]:
            assert words in result.err
        assert project.read_all() == before


@pytest.mark.parametrize("body", ["raise ValueError('oops')", "return [Feature('x', t + 1)]"])
def test_an_effect_that_fails_as_a_candidate_is_refused_by_name(make_project, zerodrift, body):
    project = make_project(runs=2, dwell=False)
    (project.directory / "own.py").write_text(f"{HEAD}    {body}{TAIL}")
    text = project.toml.read_text()
    project.toml.write_text(text + '\n[plugins]\nfiles = ["own.py"]\n')
    result = zerodrift("diagnose", "-C", project.directory, "--trust")
    assert result.code == 2
    assert "own.py:8: effect 'mine': build raised" in result.err


def write_own(directory, power):
    directory.mkdir()
    path = directory / "own.py"
    body = f"return [Feature('x', ops.power(t, {power}))]"
    path.write_text(f"{HEAD}    {body}{TAIL}".replace("my own", f"power {power}"))
    return path


def test_two_projects_keep_their_own_effects_in_one_process(tmp_path):
    one, other = write_own(tmp_path / "one", 2), write_own(tmp_path / "other", 3)
    first, second = load_catalogue([one]), load_catalogue([other])
    assert (first["mine"].title, second["mine"].title) == ("power 2", "power 3")
    assert first["mine"].file == str(one)
    assert second["mine"].file == str(other)
    assert "mine" not in load_catalogue()


def test_a_file_that_fails_leaves_nothing_behind(tmp_path):
    path = write_own(tmp_path / "one", 2)
    path.write_text(path.read_text() + "\nraise RuntimeError('late')\n")
    with pytest.raises(Exception, match="late"):
        load_catalogue([path])
    assert "mine" not in load_catalogue()
    good = write_own(tmp_path / "two", 2)
    assert load_catalogue([good])["mine"].title == "power 2"


def test_a_file_read_again_is_the_file_as_it_is_now(tmp_path):
    path = write_own(tmp_path / "one", 2)
    load_catalogue([path])
    path.write_text(path.read_text().replace("power 2", "changed"))
    assert load_catalogue([path])["mine"].title == "changed"
