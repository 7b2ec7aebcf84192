"""The manifest names every file of a firmware and all it was made from, and what became of it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.golden.vectors import load
from tests.verify.conftest import write_firmware

from zerodrift.base.config import load_config
from zerodrift.base.errors import CheckError
from zerodrift.base.records import render_sealed, to_dict
from zerodrift.c_runtime.compilers import RUNTIME_FILES
from zerodrift.tasks.built import read_firmware
from zerodrift.verify.manifest import FILE_NAME, ManifestFinding, check_manifest, load_manifest
from zerodrift.verify.summary import (
    BudgetSummary,
    ChipError,
    Claims,
    FirmwareSummary,
    StackSummary,
    StageErrors,
    Statement,
)
from zerodrift.verify.vectors import count_lines, draw_golden, draw_sequences

NOT_INCLUDED = {"zd_exp2.h", "zd_lstm.h", "zd_lstm_rows.h", "zd_layer_norm.h"}
"""Of the runtime: what the project's model, lag, delay and GRU, has no use for."""
SHIPPED = {
    *("front_end.h", "front_end.c", "front_end.dbc", "model.json", "certificate.json"),
    *(path.name for path in RUNTIME_FILES if path.name not in NOT_INCLUDED),
}
BUILT = {"model.json", "integer.onnx", "golden.npz", "certificate.json"}


def find(project: Path) -> list[ManifestFinding]:
    check = check_manifest(load_config(project))
    assert not check.not_checked
    return list(check.findings)


def test_every_file_and_every_input_is_listed(pristine: Path) -> None:
    manifest = load_manifest(pristine / "firmware" / "manifest.json")
    there = {path.name for path in (pristine / "firmware").iterdir()}
    assert set(manifest.firmware) == SHIPPED == there - {"manifest.json"}
    assert set(manifest.build) == BUILT
    assert set(manifest.inputs.logs) == {"logs/train_1.csv", "logs/train_2.csv", "logs/test.csv"}
    tables = {"sensor", "outputs", "logs", "firmware"}
    assert set(manifest.inputs.configuration) == {f"zerodrift.toml [{t}]" for t in tables}
    assert manifest.forced == () and manifest.compiler
    assert find(pristine) == []


def test_the_same_project_elsewhere_gives_the_same_bytes(pristine: Path, tmp_path: Path) -> None:
    again = write_firmware(tmp_path / "somewhere" / "else")
    name = Path("firmware", "manifest.json")
    assert (again / name).read_bytes() == (pristine / name).read_bytes()
    moved = Path(shutil.copytree(pristine, tmp_path / "moved"))
    assert find(moved) == []


def test_what_was_forced_is_written_down(tmp_path: Path) -> None:
    project = write_firmware(tmp_path / "p", forced=("Fz: worse than physics alone",))
    manifest = load_manifest(project / "firmware" / "manifest.json")
    assert manifest.forced == ("Fz: worse than physics alone",)


@pytest.mark.parametrize("name", sorted(SHIPPED))
@pytest.mark.parametrize("how", ["deleted", "cut", "one bit"])
def test_every_shipped_file_is_watched(name: str, how: str, project: Path) -> None:
    spoil(project / "firmware" / name, how)
    (finding,) = find(project)
    assert finding.name == f"firmware/{name}" and finding.text.startswith(f"firmware/{name}: ")
    assert finding.kind == ("missing" if how == "deleted" else "changed")
    assert not finding.is_stale


@pytest.mark.parametrize("name", sorted(BUILT))
@pytest.mark.parametrize("how", ["deleted", "cut", "one bit"])
def test_every_built_file_is_watched(name: str, how: str, project: Path) -> None:
    spoil(project / "build" / name, how)
    (finding,) = find(project)
    assert finding.name == f"build/{name}"


def spoil(path: Path, how: str) -> None:
    content = path.read_bytes()
    if how == "deleted":
        path.unlink()
    elif how == "cut":
        path.write_bytes(content[: len(content) // 2])
    else:
        path.write_bytes(content[:-2] + bytes([content[-2] ^ 1]) + content[-1:])


def test_a_changed_a_gone_and_a_new_log_are_named(project: Path) -> None:
    logs = project / "logs"
    (logs / "train_1.csv").write_text("time_s\n1\n")
    (logs / "train_2.csv").unlink()
    (logs / "train_3.csv").write_text("time_s\n3\n")
    findings = {f.name: f for f in find(project)}
    assert set(findings) == {f"logs/train_{k}.csv" for k in (1, 2, 3)}
    assert all(f.is_stale for f in findings.values())
    words = [findings[f"logs/train_{k}.csv"].text for k in (1, 2, 3)]
    assert ["changed" in words[0], "gone" in words[1], "new" in words[2]] == [True] * 3


def test_a_changed_table_of_the_configuration_is_named_and_a_comment_is_none(project: Path) -> None:
    toml = project / "zerodrift.toml"
    text = toml.read_text()
    toml.write_text("# a remark\n" + text.replace("\n\n", "\n\n\n"))
    assert find(project) == []
    toml.write_text(text.replace("full_scale = 2000", "full_scale = 1000"))
    (finding,) = find(project)
    assert finding.name == "zerodrift.toml [outputs]" and finding.is_stale
    toml.write_text(text + '\n[[effect]]\nkind = "dark_current"\n')
    (finding,) = find(project)
    assert finding.name == "zerodrift.toml [effect]" and "new" in finding.text


def test_firmware_of_another_version_is_not_stale_for_it(project: Path) -> None:
    path = project / "firmware" / "manifest.json"
    body = json.loads(path.read_text())
    body["zerodrift"] = "0.0.7"
    path.write_text(json.dumps(body))
    assert find(project) == []


def test_a_missing_manifest_fails_because_the_header_names_it(project: Path) -> None:
    (project / "firmware" / "manifest.json").unlink()
    (finding,) = find(project)
    assert finding.kind == "missing" and "front_end.h" in finding.text


def test_firmware_from_before_manifests_is_told_as_not_checked(project: Path) -> None:
    (project / "firmware" / "manifest.json").unlink()
    header = project / "firmware" / "front_end.h"
    lines = header.read_text().splitlines(keepends=True)
    header.write_text("".join(line for line in lines if "_MANIFEST" not in line))
    check = check_manifest(load_config(project))
    assert not check.findings
    assert [n.what for n in check.not_checked] == ["manifest"]


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "{}", '{"format": 99}', "null", '{"format": 1, "forced": "x"}', "[" * 9999],
)
def test_a_damaged_manifest_is_a_finding(text: str, project: Path) -> None:
    (project / "firmware" / "manifest.json").write_text(text)
    (finding,) = find(project)
    assert finding.kind == "damaged" and "manifest.json" in finding.text


def test_require_names_every_finding(project: Path) -> None:
    (project / "firmware" / "zd_runtime.c").unlink()
    (project / "logs" / "test.csv").write_text("")
    with pytest.raises(CheckError) as caught:
        check_manifest(load_config(project)).require("firmware/")
    assert "zd_runtime.c" in str(caught.value) and "test.csv" in str(caught.value)


def make_summary(model_hash: str) -> FirmwareSummary:
    """Return what `firmware` would have kept of a model."""
    one = {"Fz": 1.0}
    return FirmwareSummary(
        bit_exact=True,
        vectors=100,
        backends=("reference", "C"),
        flash_bytes=1,
        ram_bytes=2,
        stack_bytes=3,
        stack=StackSummary("cc", ("-O2",), {"step": 3}),
        core="cortex-m4",
        instructions_per_step={"cortex-m4": 10},
        rmse=StageErrors(uncompensated=one, float=one, integer=one),
        bias=one,
        rmse_integer_to_float=one,
        error_budget=BudgetSummary(one, one, (), ()),
        rmse_pct_fs=one,
        units={"Fz": "N"},
        held_out=True,
        tared=False,
        runs=("test",),
        model_hash=model_hash,
        certificate=Claims(5),
        gate="test logs",
        chip_error={"Fz": ChipError(1.0, 0.0, 0.0, 0.0)},
        warnings=(Statement(kind="out_of_range", text="a run."),),
        refused=(Statement(kind="not_judged", output="Fz", text="why."),),
        forced=True,
        written=True,
        files=(),
    )


def test_report_and_page_show_no_firmware_that_is_stale_or_spoilt(project: Path) -> None:
    model_hash = load_manifest(project / "firmware" / FILE_NAME).model_hash
    told = project / "build" / "firmware.json"
    summary = make_summary(model_hash)
    told.write_bytes(render_sealed(to_dict(summary)))
    firmware, certificate, note = read_firmware(load_config(project))
    assert firmware == summary and certificate is not None and not note
    told.write_bytes(render_sealed({"model_hash": model_hash, "chip_error": {}}))
    firmware, certificate, note = read_firmware(load_config(project))
    assert firmware is None and certificate is None
    assert "of an earlier version" in note
    told.write_bytes(render_sealed(to_dict(summary)))
    (project / "logs" / "test.csv").write_text("")
    firmware, certificate, note = read_firmware(load_config(project))
    assert firmware is None and certificate is None
    assert "logs/test.csv: was changed" in note and "zerodrift firmware" in note


@pytest.mark.spread(1, "name", ["ordinary", "saturation", "front_end"])
def test_golden_vectors_read_every_line_of_the_table_that_others_read(name: str) -> None:
    model = load(name).model
    sequences = draw_sequences(model, 1000)
    golden = draw_golden(model, sequences["walk"])
    others = [count_lines(model, codes) for codes in sequences.values()]
    missed = np.logical_or.reduce(others) & ~count_lines(model, golden)
    assert missed.sum() <= 0.01 * count_lines(model, golden).sum()
    for k, channel in enumerate(model.channels):
        assert {channel.least, channel.most} <= {*golden[:, k].tolist()}
