"""One noise floor per project: every command tells the same number."""

import json

import pytest

pytestmark = pytest.mark.long


@pytest.mark.parametrize("dwell", [False, True])
def test_every_command_tells_the_same_floor(dwell, make_project, zerodrift):
    project = make_project(dwell=dwell)

    def read(*arguments):
        result = zerodrift(*arguments, "-C", project.directory, "--json")
        assert result.code == 0, result.out
        return json.loads(result.out)

    def list_floors():
        compared, diagnosed = read("compare"), read("diagnose")
        return [
            {name: o["noise_floor"] for name, o in found["outputs"].items()}
            for found in (compared, diagnosed)
        ]

    told = list_floors()
    told.append(read("add", "thermal_lag")["noise_floor"])
    told += list_floors()
    told += [step["noise_floor"] for step in read("history")["steps"]]
    told.append(read("remove", "thermal_lag")["noise_floor"])
    assert len(told) == 8
    assert all(floor == told[0] for floor in told), told
    assert all(value > 0.0 for value in told[0].values())
