"""What the commands print as JSON is described, as it is now."""

import ast
import dataclasses
import json

import pytest
from tests.house.test_order import ROOT
from tests.schemas import FOLDER, validate

from zerodrift.base.records import from_json, get_schema_name, list_fields, to_dict
from zerodrift.cli.schemas import render_schemas
from zerodrift.report.results import RESULTS, DoctorResult
from zerodrift.verify.machine import Item

COMMANDS = ROOT / "src/zerodrift/cli"


def test_schemas_are_current() -> None:
    """Else: `python -m zerodrift.cli.schemas`."""
    kept = {path.name: path.read_text("utf-8") for path in FOLDER.glob("*.json")}
    assert kept == render_schemas()


def test_every_command_prints_a_record() -> None:
    """`print_json` is called in one place, by `print_result`."""
    calls = [
        f"{path.name}:{node.lineno}"
        for path in COMMANDS.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print_json"
    ]
    assert len(calls) == 1 and calls[0].startswith("common.py"), calls


def test_each_record_names_its_schema_once() -> None:
    names = [get_schema_name(kind) for kind in RESULTS]
    assert all(name.rpartition("/")[2].isdigit() for name in names)
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("kind", RESULTS, ids=get_schema_name)
def test_records_are_frozen_and_say_what_their_keys_mean(kind: type) -> None:
    assert kind.__dataclass_params__.frozen
    for one, _ in list_fields(kind):
        assert one.name != "schema"


def test_a_record_is_written_and_read_back() -> None:
    record = DoctorResult(True, (Item("packages", "numpy", "2.0", "arithmetic"),))
    told = json.loads(json.dumps(to_dict(record)))
    validate(told)
    assert told["schema"] == "doctor/1"
    assert from_json(DoctorResult, told) == record


def test_a_record_that_is_not_as_its_schema_says_is_refused() -> None:
    told = to_dict(DoctorResult(True, (Item("packages", "numpy", "2.0", "arithmetic"),)))
    for wrong in ({"can_check": 1}, {"items": [{}]}, {"more": 1}, {"schema": "doctor/2"}):
        with pytest.raises(AssertionError):
            validate({**told, **wrong})
    with pytest.raises(AssertionError):
        validate({key: value for key, value in told.items() if key != "items"})


def test_light_commands_validate(zerodrift, tmp_path) -> None:
    """The fixture holds every --json of the suite against its schema; these take no project."""
    for command in (("doctor",), ("effects",), ("effects", "creep")):
        told = json.loads(zerodrift(*command, "-C", str(tmp_path), "--json").out)
        validate(told)


def test_no_field_is_a_plain_dictionary() -> None:
    """A mapping's keys are names of outputs, runs or the like, never of fields."""
    for kind in RESULTS:
        for one, hint in list_fields(kind):
            assert "Any" not in str(hint), (kind, one.name)
            assert not dataclasses.is_dataclass(one)
