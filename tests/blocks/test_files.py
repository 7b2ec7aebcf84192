"""Blocks as files, and the command that shows them."""

import json
import subprocess
from pathlib import Path

import pytest

from tests.blocks.test_blocks import find_design, list_units, make_block
from tests.schemas import validate
from zerodrift.base.errors import InputError
from zerodrift.blocks.files import read_block_file, read_hex, render_block, write_hex
from zerodrift.c_runtime.compilers import find_compiler


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a design and the files of two blocks."""
    design = find_design(network=True)
    (tmp_path / "design.json").write_text(design.to_text(), encoding="utf-8")
    for number in (1, 2):
        serial = f"SN{number}"
        content = make_block(design, design.fit(list_units(True)[number]), number, serial)
        for name, text in render_block(design, content, serial, 0x0800FF00).items():
            (tmp_path / name).write_bytes(text)
    return tmp_path


def test_every_form_holds_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    content = (folder / "SN1.bin").read_bytes()
    for suffix in (".hex", ".json"):
        assert read_block_file(folder / f"SN1{suffix}") == content
    main = folder / "main.c"
    main.write_text(
        '#include <stdio.h>\n#include "SN1.c"\nint main(void) {\n'
        "    return fwrite(block_SN1, sizeof(block_SN1), 1, stdout) != 1;\n}\n"
    )
    find_compiler().run([str(main), "-o", str(folder / "main")])
    told = subprocess.run([str(folder / "main")], capture_output=True, check=True).stdout
    assert told == content


def test_hex_over_a_boundary_of_64_kib_and_what_is_wrong_with_it(folder: Path) -> None:
    content = (folder / "SN1.bin").read_bytes()
    text = write_hex(content, 0x0800FF00)
    assert text.splitlines()[0] == ":020000040800F2" and ":020000040801F1" in text
    assert read_hex(text, "a.hex") == content
    for changed, told in (
        (text.replace("00000001FF", ""), r"a.hex:\d+"),
        (text.replace(":00000001FF\n", ""), "cut"),
        (text.replace(b"ZDBK".hex().upper(), "5A444243"), "checksum"),
        ("\n".join(line for k, line in enumerate(text.splitlines()) if k != 3), "a gap"),
    ):
        with pytest.raises(InputError, match=told):
            read_hex(changed, "a.hex")


def test_show(folder: Path, zerodrift) -> None:
    done = zerodrift("block", "show", folder / "SN1.bin", folder / "SN2.hex", "--json")
    told = json.loads(done.out)
    validate(told)
    assert [block["serial"] for block in told["blocks"]] == ["SN1", "SN2"]
    assert all(block["fields"] for block in told["blocks"])
    assert "SN1" in zerodrift("block", "show", folder / "SN1.json").out


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c[:100], "was cut"),
        (lambda c: c[:4] + b"\0" + c[5:], "older format"),
        (lambda c: b"".join(c[k : k + 4][::-1] for k in range(0, len(c), 4)), "highest byte first"),
        (lambda c: c[:90] + b"\xff" + c[91:], "CRC"),
    ],
)
def test_show_refuses(folder: Path, zerodrift, change, told: str) -> None:
    content = (folder / "SN1.bin").read_bytes()
    (folder / "bad.bin").write_bytes(change(content))
    done = zerodrift("block", "show", folder / "bad.bin")
    assert done.code == 2
    assert told in done.err and "bad.bin" in done.err


def test_show_refuses_a_serial_twice_and_another_design(folder: Path, zerodrift) -> None:
    done = zerodrift("block", "show", folder / "SN1.bin", folder / "SN1.hex")
    assert done.code == 2
    assert "serial 'SN1'" in done.err
    other = find_design(network=False)
    (folder / "design.json").write_text(other.to_text(), encoding="utf-8")
    done = zerodrift("block", "show", folder / "SN1.bin")
    assert done.code == 2
    assert f"expected {other.identity[:16]}" in done.err
