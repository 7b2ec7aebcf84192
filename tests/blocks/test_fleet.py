"""`fleet` with blocks: one program, a block per unit."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from tests.fleet.conftest import SENSORS, TOML, write_sensor
from zerodrift.blocks.design import load_design
from zerodrift.fleet import work

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


def test_one_program_and_a_block_per_unit(fleet: Path, zerodrift) -> None:
    done = zerodrift("fleet", "-C", fleet, "--jobs", 1, "--force", "--json")
    told = json.loads(done.out)
    assert done.code == 0, (done.err, told)
    out = fleet / "firmware"
    assert told["blocks"]["units"] == len(SENSORS) and not told["blocks"]["refused"]
    assert told["blocks"]["vectors"] == 2000 * len(SENSORS)
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
