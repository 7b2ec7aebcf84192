"""A project's page has the same address each time, and nobody else can choose it."""

import io
import json
import os
import shutil
import subprocess
import zipfile
from pathlib import Path
from urllib.parse import quote

import pytest
from tests.workbench.conftest import serve
from tests.workbench.test_security import ask

from zerodrift.codegen.application import write_snippet
from zerodrift.workbench.early import PageAddress, find_address, keep_address
from zerodrift.workbench.server import pack_files


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "zerodrift" / "workbench"


def test_restarted_page_has_the_same_port_and_token(tmp_path):
    project = tmp_path / "project"
    project.mkdir()
    with serve(project) as first:
        known = (first.port, first.token)
    with serve(project) as second:
        assert (second.port, second.token) == known
    other = tmp_path / "other"
    other.mkdir()
    with serve(other) as third:
        assert third.token != known[1]


def test_port_that_is_taken_meanwhile_is_another_one(tmp_path):
    first, second = tmp_path / "one", tmp_path / "two"
    first.mkdir()
    second.mkdir()
    with serve(first) as bench:
        keep_address(second, PageAddress(bench.port, "t" * 32))
        with serve(second) as other:
            assert other.port != bench.port
            assert other.token == "t" * 32


def test_address_is_for_its_owner_alone_and_outside_of_the_project(tmp_path, state):
    project = tmp_path / "project"
    project.mkdir()
    keep_address(project, PageAddress(40123, "t" * 32))
    (file,) = state.iterdir()
    assert file.stat().st_mode & 0o077 == 0
    assert list(project.iterdir()) == []
    assert find_address(project) == PageAddress(40123, "t" * 32)
    file.chmod(0o644)
    assert find_address(project).token != "t" * 32


@pytest.mark.parametrize(
    "text", ["", "[]", '{"port": 80, "token": "' + "t" * 32 + '"}', '{"port": 40123, "token": "t"}']
)
def test_damaged_address_is_not_believed(tmp_path, state, text):
    keep_address(tmp_path, PageAddress(40123, "t" * 32))
    (file,) = state.iterdir()
    file.write_text(text)
    assert find_address(tmp_path).port == 0


def test_address_that_is_a_link_is_not_followed(tmp_path, state):
    keep_address(tmp_path, PageAddress(40123, "t" * 32))
    (file,) = state.iterdir()
    moved = tmp_path / "moved.json"
    file.rename(moved)
    file.symlink_to(moved)
    assert find_address(tmp_path).port == 0


def test_log_of_a_name_too_long_is_answered(tmp_path):
    project = tmp_path / "project"
    project.mkdir()
    with serve(project) as bench:
        for name in ("a" * 256 + ".csv", "ä" * 130 + ".csv"):
            path = f"/upload?token={bench.token}&name={quote(name)}"
            answer, text = ask(bench, path, method="POST", body=b"a,b\n1,2\n")
            assert answer.status == 400
            assert "Rename the file" in json.loads(text)["error"]


def test_firmware_is_packed_whole_and_nothing_else(tmp_path):
    (tmp_path / "firmware").mkdir()
    (tmp_path / "firmware" / "cell.c").write_text("int x;\n")
    (tmp_path.parent / "secret.txt").write_text("no")
    files = ("firmware/cell.c", "firmware/gone.h", "../secret.txt")
    packed = pack_files(tmp_path, files)
    assert zipfile.ZipFile(io.BytesIO(packed)).namelist() == ["firmware/cell.c"]
    os.utime(tmp_path / "firmware" / "cell.c", (1, 1))
    assert pack_files(tmp_path, files) == packed


def test_snippet_compiles_beside_the_generated_header(tmp_path):
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("there is no C compiler")
    header = tmp_path / "cell.h"
    header.write_text(
        "#include <stdint.h>\n#define CELL_OUTPUTS 2\n#define CELL_FZ 0\n#define CELL_M_X 1\n"
        "typedef struct { int16_t temperature; } cell_input_t;\n"
        "typedef struct { uint32_t identity; } cell_state_t;\n"
        "uint32_t cell_selftest(void);\n"
        "void cell_settle(cell_state_t *s, const cell_input_t *in);\n"
        "uint32_t cell_step(cell_state_t *s, const cell_input_t *in, int32_t *drift);\n"
    )
    text = write_snippet(
        ("firmware/zd_runtime.h", "firmware/cell.h", "firmware/cell.c"), ("Fz", "M x")
    )
    source = tmp_path / "main.c"
    source.write_text(text)
    subprocess.run(
        [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-c", source, "-o", tmp_path / "x.o"],
        check=True,
        cwd=tmp_path,
    )
    assert Path(tmp_path / "x.o").exists()
