"""`fleet` with blocks: one program, a block per unit."""

import errno
import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest

from tests.fleet.conftest import SENSORS, TOML, write_sensor
from tests.fleet.test_refused_units import spoil
from zerodrift.blocks.design import load_design
from zerodrift.blocks.fields import put, read
from zerodrift.dataset.runs import Dataset
from zerodrift.fleet import block_work, work
from zerodrift.fleet.work import RANDOM_STEPS, Spooled, spool

pytestmark = pytest.mark.long

BLOCK = '\n[firmware]\ncoefficients = "block"\ncalibrated = 2026-03-01\n'


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Return three simulated units, each with a dark current of its own."""
    for seed, sensor in enumerate(SENSORS):
        write_sensor(tmp_path, sensor, seed)
    (tmp_path / "zerodrift.toml").write_text(TOML + BLOCK, encoding="utf-8")
    return tmp_path


def read_program(out: Path) -> bytes:
    """Return the C of the one program."""
    (path,) = (p for p in (out / "program").glob("*.c") if not p.name.startswith("zd_"))
    return path.read_bytes()


def list_vectors(told: dict) -> list[int]:
    """Return how many steps of each unit were compared."""
    return [result["vectors"] for result in told["results"]]


def count_least(fleet: Path, sensor: str) -> int:
    """Return the rows of a unit's logs, and the inputs that are drawn beside them."""
    logs = (fleet / "fleet" / sensor).glob("*.csv")
    rows = sum(len(log.read_text().splitlines()) - 1 for log in logs)
    return rows + RANDOM_STEPS + block_work.COLD_STEPS


def test_one_program_and_a_block_per_unit(fleet: Path, zerodrift) -> None:
    done = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force", "--json")
    told = json.loads(done.out)
    assert done.code == 0, (done.err, told)
    out = fleet / "firmware"
    assert told["blocks"]["units"] == len(SENSORS) and not told["blocks"]["refused"]
    assert told["blocks"]["vectors"] == sum(list_vectors(told))
    for sensor, vectors in zip(SENSORS, list_vectors(told), strict=True):
        assert vectors > count_least(fleet, sensor)
    assert sorted(p.name for p in out.iterdir()) == ["blocks", "program", "runtime"]
    design = out / "program" / "design.json"
    shown = zerodrift("block", "show", "--design", design, *sorted((out / "blocks").glob("*.bin")))
    assert shown.code == 0 and all(sensor in shown.out for sensor in SENSORS)
    assert len({p.read_bytes() for p in (out / "blocks").glob("*.bin")}) == len(SENSORS)
    source = read_program(out)
    again = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force", "--json")
    assert json.loads(again.out)["blocks"] == told["blocks"]  # kept results, the same program
    assert read_program(out) == source
    assert load_design(design).identity == told["blocks"]["design"]


@pytest.mark.long
def test_the_certificate_is_that_of_the_one_program_alone(
    fleet: Path, zerodrift, monkeypatch
) -> None:
    asked = []
    monkeypatch.setattr(work, "certify_checked", lambda *all_of: asked.append(all_of))
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 0
    assert not asked
    program = fleet / "firmware" / "program"
    certificate = json.loads((program / "certificate.json").read_text())
    (source,) = (p for p in program.glob("*.c") if not p.name.startswith("zd_"))
    assert hashlib.sha256(source.read_bytes()).hexdigest() in json.dumps(certificate)


def test_a_unit_that_does_not_fit_the_program_is_told(fleet: Path, zerodrift) -> None:
    moved = shutil.move(fleet / "fleet" / "SN03", fleet / "later")
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 0
    shutil.move(moved, fleet / "fleet" / "SN03")
    for path in (fleet / "fleet" / "SN03").glob("*.csv"):
        lines = path.read_text().splitlines()
        names = lines[0].split(",")
        at = next(k for k, name in enumerate(names) if "Fz" in name and "ref" not in name)
        changed = [lines[0]]
        for line in lines[1:]:
            cells = line.split(",")
            cells[at] = f"{100 * float(cells[at]):.5f}"
            changed.append(",".join(cells))
        path.write_text("\n".join(changed) + "\n")
    done = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force")
    assert done.code == 1
    assert "no block for SN03" in done.err and "2 blocks of" in done.out
    assert (fleet / "firmware" / "blocks" / "SN01.bin").is_file()
    assert not (fleet / "firmware" / "blocks" / "SN03.bin").exists()


def test_units_that_were_tried_in_the_program_are_not_tried_again(
    fleet: Path, zerodrift, monkeypatch
) -> None:
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 0
    tried = []
    try_units = block_work.try_units
    monkeypatch.setattr(
        block_work,
        "try_units",
        lambda run, sensors: tried.append(sensors) or try_units(run, sensors),
    )
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 0
    assert not tried
    block = fleet / "firmware" / "blocks" / "SN02.bin"
    block.write_bytes(block.read_bytes()[:-1] + b"\0")
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 0
    assert tried == [("SN02",)]
    toml = fleet / "zerodrift.toml"
    toml.write_text(toml.read_text().replace("2026-03-01", "2026-03-02"))
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 0
    assert len(tried) == 1  # no unit's numbers have changed, so that each keeps its own date


def test_a_run_that_ends_between_the_passes_goes_on_from_the_first(
    fleet: Path, zerodrift, monkeypatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as cut:
        cut.setattr(block_work, "try_units", interrupt)
        assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 130
    assert not (fleet / "firmware" / "blocks").exists()
    went_on = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force", "--json")
    told = json.loads(went_on.out)
    assert [result["kept"] for result in told["results"]] == [True] * len(SENSORS)
    written = {p.name: p.read_bytes() for p in (fleet / "firmware" / "blocks").iterdir()}
    whole = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force", "--fresh", "--json")
    assert json.loads(whole.out)["blocks"] == told["blocks"]
    for name, content in written.items():
        assert (fleet / "firmware" / "blocks" / name).read_bytes() == content
    for before, after in zip(told["results"], json.loads(whole.out)["results"], strict=True):
        assert before["outputs"] == after["outputs"]


def test_a_block_that_answers_differently_is_told_and_not_written(
    fleet: Path, zerodrift, monkeypatch
) -> None:
    """Block and self-test are of another number than the model has; it shows by one LSB."""

    def move(function):
        def answer(common, model, *others):
            place = next(f.place for f in common.fields if f.place.name.endswith("drift_bias"))
            moved = put(model, {place: read(model, place) + 2**30})
            return function(common, moved, *others)

        return answer

    monkeypatch.setattr(block_work, "encode", move(block_work.encode))
    monkeypatch.setattr(block_work, "compute_answers", move(block_work.compute_answers))
    done = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force", "--json")
    assert done.code == 1 and "no unit has a result" in done.err
    for result in json.loads(done.out)["results"]:
        assert result["status"] == "error"
        assert "the C differs from the reference: step" in result["reasons"][0]
    assert not list((fleet / "firmware").rglob("*.bin"))


def test_a_refused_unit_has_no_block_and_no_part_in_the_design(fleet: Path, zerodrift) -> None:
    spoil(fleet / "fleet" / SENSORS[1] / "chamber_1.csv")
    done = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--json")
    told = json.loads(done.out)
    assert done.code == 1
    assert [r["status"] for r in told["results"]] == ["pass", "error", "pass"]
    assert 'accept = ["chamber_1: gain"]' in told["results"][1]["reasons"][0]
    out = fleet / "firmware"
    assert sorted(p.stem for p in (out / "blocks").glob("*.bin")) == [SENSORS[0], SENSORS[2]]
    shutil.rmtree(fleet / "fleet" / SENSORS[1])
    shutil.rmtree(out)
    again = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--json")
    assert json.loads(again.out)["blocks"]["design"] == told["blocks"]["design"]


def test_a_process_that_reaches_neither_spool_nor_library_gives_the_same(
    fleet: Path, zerodrift, tmp_path_factory, monkeypatch
) -> None:
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force").code == 0
    runs = []
    try_units = block_work.try_units

    def keep(run, sensors):
        found = try_units(run, sensors)
        elsewhere = replace(
            run,
            design=replace(run.design, spool=tmp_path_factory.mktemp("a") / "none"),
            program=replace(run.program, library=fleet / "none.so"),
        )
        runs.append((found, try_units(elsewhere, sensors)))
        return found

    monkeypatch.setattr(block_work, "try_units", keep)
    assert zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force", "--fresh").code == 0
    assert runs and all(here == there for here, there in runs)


def test_a_spool_without_room_is_left_empty(tmp_path: Path, monkeypatch) -> None:
    def write_part(path: Path, content: bytes) -> int:
        path.open("wb").write(content[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    content = Spooled("mark", cast(Dataset, None), None)
    spool(tmp_path, "SN01", content)
    assert (tmp_path / "SN01.pickle").is_file()
    monkeypatch.setattr(Path, "write_bytes", write_part)
    spool(tmp_path, "SN01", content)
    assert not list(tmp_path.iterdir())
