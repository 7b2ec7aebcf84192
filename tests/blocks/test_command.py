"""`[firmware] coefficients = "block"`: built, verified, recalibrated, refused."""

from pathlib import Path

import pytest

from tests.loop.conftest import write_project
from zerodrift.base.errors import InputError
from zerodrift.blocks.block import decode_header
from zerodrift.blocks.files import BLOCK_FILES

BLOCK = '\n[firmware]\ncoefficients = "block"\nserial = "SN7"\ncalibrated = 2026-03-01\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a project whose coefficients lie in a block."""
    project = write_project(tmp_path)
    text = project.toml.read_text(encoding="utf-8")
    project.toml.write_text(text + BLOCK, encoding="utf-8")
    return tmp_path


@pytest.mark.long
def test_firmware_and_verify(folder: Path, zerodrift) -> None:
    built = zerodrift("firmware", "-C", folder, "--json")
    assert built.code == 0, built.err
    out = folder / "firmware"
    assert {*BLOCK_FILES, "design.json", "certificate.json"} <= {p.name for p in out.iterdir()}
    assert '"reference","host"' in built.out.replace(" ", "").replace("\n", "")
    assert zerodrift("verify", "-C", folder, "--require", "manifest").code == 0
    assert zerodrift("verify", "-C", folder, "--certificate").code == 0
    unproven = zerodrift("verify", "-C", folder, "--prove")
    assert unproven.code == 2 and "lie in a block" in unproven.err
    shown = zerodrift("block", "show", out / "block.hex")
    assert "SN7" in shown.out and "2026-03-01" in shown.out
    refused = zerodrift("package", "cmake", "-C", folder)
    assert refused.code == 2 and "block" in refused.err


@pytest.mark.long
def test_a_recalibration_changes_the_block_alone(folder: Path, zerodrift) -> None:
    assert zerodrift("firmware", "-C", folder).code == 0
    out, toml = folder / "firmware", folder / "zerodrift.toml"
    source, block = (out / "cell.c").read_bytes(), (out / "block.bin").read_bytes()
    text = toml.read_text(encoding="utf-8").replace("2026-03-01", "2026-09-01")
    toml.write_text(text.replace("run_*.csv", "run_[0-3].csv"), encoding="utf-8")
    again = zerodrift("firmware", "-C", folder)
    assert again.code == 0 and "block of SN7: sequence" in again.out
    old, new = (decode_header(b, "block").notes for b in (block, (out / "block.bin").read_bytes()))
    assert new.sequence > old.sequence and new.calibrated > old.calibrated
    assert (out / "cell.c").read_bytes() == source
    assert (out / "block.bin").read_bytes() != block
    damaged = bytearray((out / "block.bin").read_bytes())
    damaged[100] ^= 1
    (out / "block.bin").write_bytes(damaged)
    told = zerodrift("verify", "-C", folder)
    assert told.code == 1 and "block.bin" in told.err


@pytest.mark.long
def test_constants_again_leave_no_block_behind(folder: Path, zerodrift) -> None:
    assert zerodrift("firmware", "-C", folder).code == 0
    toml = folder / "zerodrift.toml"
    text = toml.read_text(encoding="utf-8")
    toml.write_text(text.replace('"block"', '"constants"'), encoding="utf-8")
    assert zerodrift("firmware", "-C", folder).code == 0
    assert not {*BLOCK_FILES, "design.json"} & {p.name for p in (folder / "firmware").iterdir()}


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('coefficients = "flash"', "constants"),
        (f'serial = "{25 * "x"}"', "24 bytes"),
        ('calibrated = "March"', "2026-03-01"),
        ("sequence = 0", "sequence"),
        ("block_address = 3", "8 divides"),
    ],
)
def test_what_stands_wrong_in_the_table(tmp_path: Path, line: str, told: str) -> None:
    from zerodrift.base.config import load_config

    project = write_project(tmp_path, runs=1, dwell=False)
    text = project.toml.read_text(encoding="utf-8")
    project.toml.write_text(f"{text}\n[firmware]\n{line}\n", encoding="utf-8")
    with pytest.raises(InputError, match=told):
        load_config(tmp_path)
