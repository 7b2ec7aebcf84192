"""`verify` on firmware that was spoilt in one place: each is reported, by name, with exit code 1.

Where a test says `forge`, the manifest was made to agree with the spoilt file, so that only
building and running can tell.
"""

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.mutants.judge import identify_files
from click.testing import CliRunner
from tests.golden.vectors import load
from tests.verify.conftest import MODEL

from zerodrift.base.errors import ZerodriftError
from zerodrift.base.records import render_sealed
from zerodrift.cli.main import cli
from zerodrift.export.golden import load_golden
from zerodrift.verify import folder_check, ways
from zerodrift.verify.manifest import FILE_NAME

pytestmark = pytest.mark.long

HEADER, SOURCE = "firmware/front_end.h", "firmware/front_end.c"


class Outcome:
    """Exit code, JSON (None without) and the error's message of one `verify`."""

    def __init__(self, project: Path, *options: str) -> None:
        result = CliRunner().invoke(
            cli, ["verify", "-C", str(project), "--json", "--trust", *options]
        )
        self.code, self.told = result.exit_code, str(result.exception or "")
        if isinstance(result.exception, ZerodriftError):
            self.code = result.exception.exit_code
        elif result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        self.json: dict[str, Any] = json.loads(result.stdout) if result.stdout else {}


def forge(project: Path) -> None:
    """Make the manifest say what lies there."""
    path = project / "firmware" / FILE_NAME
    body = json.loads(path.read_text())
    for key in ("firmware", "build"):
        for name in list(body[key]):
            file = project / key / name
            if file.exists():
                body[key][name] = hashlib.sha256(file.read_bytes()).hexdigest()
            else:
                del body[key][name]
    path.write_text(json.dumps(body))


def make_another_version(project: Path, remark: str = "/* of another version */") -> None:
    """Give C and runtime a remark more, and the identities of their text as it is then."""
    folder = project / "firmware"
    texts = {path.name: path.read_text() for path in folder.glob("*.[ch]")}
    for name in ("zd_runtime.h", "front_end.h"):
        texts[name] += f"{remark}\n"
    for name, text in identify_files(texts, "front_end").items():
        (folder / name).write_text(text)


def edit(path: Path, pattern: str, replacement: str | Callable[[re.Match[str]], str]) -> None:
    text = path.read_text()
    edited, count = re.subn(pattern, replacement, text, count=1, flags=re.DOTALL)
    assert count == 1 and edited != text
    path.write_text(edited)


def test_everything_is_built_and_run_where_nothing_was_spoilt(pristine: Path) -> None:
    outcome = Outcome(pristine, "--require", "manifest", "--require", "cortex-m0plus")
    assert outcome.code == 0, outcome.told
    told = outcome.json
    assert told["bit_exact"] and not told["failures"] and not told["header"]
    assert not told["changed"] and not told["stale"] and told["forced"] == []
    assert [n["what"] for n in told["not_checked"]] == ["cortex-m55"]
    model_ways = {w.name for w in (*ways._HOST_FAST, *ways._HOST_ANY, *ways._CORES_FAST)}
    cores = {"cortex-m0plus", "cortex-m3", "cortex-m4", "cortex-m7", "cortex-m33", "rv32imc"}
    assert {*told["backends"]} == {"reference", "host", "onnx", *model_ways, *cores}


@pytest.mark.parametrize("name", ["zd_runtime.c", "zd_runtime.h", "zd_signals.h", "front_end.c"])
@pytest.mark.parametrize("how", ["deleted", "cut", "uncompilable"])
@pytest.mark.parametrize("forged", [False, True])
def test_c_that_cannot_be_built_is_reported(
    name: str, how: str, forged: bool, project: Path, few_ways: object
) -> None:
    path = project / "firmware" / name
    text = path.read_text()
    if how == "deleted":
        path.unlink()
    else:
        path.write_text(text[: len(text) // 2] if how == "cut" else "this is no C\n")
    if forged:
        forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and name in outcome.told
    assert not outcome.json["bit_exact"] and outcome.json["failures"]
    assert bool(outcome.json["changed"]) != forged


@pytest.mark.parametrize("text", ["", "static int zd_nothing;\n"])
def test_runtime_that_lacks_what_is_called_is_reported(
    text: str, project: Path, few_ways: object
) -> None:
    (project / "firmware" / "zd_runtime.c").write_text(text)
    outcome = Outcome(project)
    assert outcome.code == 1 and "cannot be loaded" in outcome.told


def test_damaged_record_of_another_command_is_told(project: Path, few_ways: object) -> None:
    path = project / "build" / "firmware.json"
    path.write_bytes(render_sealed({"model_hash": load(MODEL).model.hash}))
    assert Outcome(project).code == 0
    path.write_bytes(path.read_bytes().replace(b'"model', b'"nodel', 1))
    outcome = Outcome(project)
    assert outcome.code == 1 and "build/firmware.json: is damaged" in outcome.told
    path.write_bytes(render_sealed({"model_hash": "0" * 64}))
    outcome = Outcome(project)
    assert outcome.code == 1 and "build/firmware.json: is of model 000000000000" in outcome.told


@pytest.mark.parametrize("how", ["deleted", "cut", "nonsense", "another model's"])
@pytest.mark.parametrize("forged", [False, True])
def test_the_integer_onnx_is_run_as_it_lies(
    how: str, forged: bool, project: Path, few_ways: object
) -> None:
    path = project / "build" / "integer.onnx"
    content = path.read_bytes()
    if how == "deleted":
        path.unlink()
    elif how == "another model's":
        from tests.golden.vectors import load

        from zerodrift.export.integer_onnx import build_integer_onnx

        path.write_bytes(build_integer_onnx(load("odd_hidden").model))
    else:
        path.write_bytes(content[: len(content) // 2] if how == "cut" else b"nonsense")
    if forged:
        forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1
    assert "onnx" in outcome.told
    assert "onnx" not in outcome.json.get("backends", [])


def test_one_changed_number_in_the_onnx_is_found(project: Path, few_ways: object) -> None:
    import onnx

    path = project / "build" / "integer.onnx"
    proto = onnx.load(str(path))

    def all_tensors(graph: onnx.GraphProto) -> list[onnx.TensorProto]:
        found = list(graph.initializer)
        for node in graph.node:
            for attribute in node.attribute:
                found += all_tensors(attribute.g) if attribute.HasField("g") else []
                found += [attribute.t] if attribute.HasField("t") else []
        return found

    largest = max(all_tensors(proto.graph), key=lambda t: len(t.raw_data))
    numbers = onnx.numpy_helper.to_array(largest).copy()
    numbers.flat[numbers.size // 2] += 64
    largest.CopyFrom(onnx.numpy_helper.from_array(numbers, largest.name))
    path.write_bytes(proto.SerializeToString())
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and "onnx, sequence" in outcome.told


LIES = {
    "FRONT_END_FZ_LSB_PER_UNIT": "7",
    "FRONT_END_SAMPLE_PERIOD_US": "UINT32_C(123)",
    "FRONT_END_FZ": "1",
    "FRONT_END_MODEL_HASH": '"' + "0" * 64 + '"',
    "FRONT_END_FLAG_TEMPERATURE_RANGE": "UINT32_C(4)",
    "FRONT_END_FLAG_CLAMPED": "UINT32_C(16)",
    "FRONT_END_FAULT_TABLES": "UINT32_C(3)",
    "FRONT_END_MODEL_ID": "UINT32_C(12345)",
}


def list_macros(header: Path) -> dict[str, str]:
    return dict(re.findall(r"^#define (\w+) ([^/\n]+?) *(?:/\*.*)?$", header.read_text(), re.M))


def test_every_lie_in_the_header_is_told_by_name(project: Path, few_ways: object) -> None:
    header = project / HEADER
    there = list_macros(header)
    outputs = [name for name in there if name.endswith("_LSB_PER_UNIT")]
    lies = {name: LIES.get(name, "7") for name in (*LIES, *outputs) if name in there}
    assert len(lies) >= 7
    for name, lie in lies.items():
        edit(header, rf"(#define {name}) {re.escape(there[name])}", rf"\g<1> {lie}")
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1
    assert {f["name"] for f in outcome.json["header"]} == set(lies)
    assert all(f"header: {name} is" in outcome.told for name in lies)


def test_a_name_that_the_header_lacks_is_told(project: Path, few_ways: object) -> None:
    edit(project / HEADER, r"#define FRONT_END_SAMPLE_PERIOD_US [^\n]*\n", "")
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and "FRONT_END_SAMPLE_PERIOD_US is missing" in outcome.told


def halve(match: re.Match[str]) -> str:
    """Return a stream with the largest number halved."""
    numbers = re.findall(r"-?\d+", match[2])
    largest = max(numbers, key=lambda n: abs(int(n)))
    return match[1] + match[2].replace(largest, str(int(largest) // 2), 1)


@pytest.mark.parametrize(
    ("kernel", "array", "way"),
    [
        ("PAIRS", "stream", "host: pairs"),
        ("PAIRS", "stream", "cortex-m4"),
        ("PAIRS", "stream", "cortex-m0plus"),
        ("ROWS", "rows", "host: rows, MVE lane by lane"),
        ("COLUMNS", "stream", "host: columns with SSE2"),
    ],
)
def test_weights_that_another_kernel_reads_are_run(
    kernel: str, array: str, way: str, project: Path, few_ways: Callable[..., None]
) -> None:
    few_ways(way)
    pattern = rf"(if ZD_KERNEL == ZD_KERNEL_{kernel}\n(?:(?!#el).)*?_{array}\[\d+\] = \{{)([^}}]*)"
    edit(project / SOURCE, pattern, halve)
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1
    assert "host" in outcome.told if kernel == "COLUMNS" else f"{way}, sequence" in outcome.told


@pytest.mark.parametrize(
    ("name", "pattern", "way"),
    [
        ("zd_gru_rows.h", r"vrshrq_n_s32\(h, 15\)", "host: rows, MVE lane by lane"),
        ("zd_gru_pairs.h", r"\(\(int32_t\)1 << 14\)", "host: pairs"),
        ("zd_gru_columns_avx2.h", r"set1_epi32\(\(int32_t\)1 << 14\)", "host: columns with AVX2"),
        (
            "zd_tanh_table.h",
            r"zd_tanh_half_slope_q19\[ZD_TANH_HALF_LINES\] = \{\s*\d+",
            "cortex-m4: ZD_SMALL",
        ),
    ],
)
def test_constants_of_kernels_that_this_host_does_not_take_are_seen(
    name: str, pattern: str, way: str, project: Path, few_ways: Callable[..., None]
) -> None:
    few_ways(way)

    def change(match: re.Match[str]) -> str:
        *_, last = re.finditer(r"\d+", match[0])
        return f"{match[0][: last.start()]}{int(last[0]) - 1}{match[0][last.end() :]}"

    edit(project / "firmware" / name, pattern, change)
    forge(project)
    outcome = Outcome(project)
    if any(n["what"] == way for n in outcome.json["not_checked"]):
        pytest.skip(f"{way} does not run here")
    assert outcome.code == 1 and way in outcome.told


def test_c_that_crashes_or_never_ends_is_a_finding(
    project: Path, few_ways: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zerodrift.verify.trial.LONGEST_S", 3)
    source = project / SOURCE
    text = source.read_text()
    for line, told in (
        ("for (volatile int zd_i = 0; zd_i < 1;) { }", "did not end"),
        ("*(volatile int *)0 = 1;", "signal"),
    ):
        source.write_text(text)
        edit(source, r"(uint32_t flags = 0;)", lambda m, line=line: f"{m[1]} {line}")
        forge(project)
        outcome = Outcome(project)
        assert outcome.code == 1 and told in outcome.told


@pytest.mark.parametrize(
    ("pattern", "text", "over"),
    [
        (
            r"uint32_t flags = 0;",
            "volatile int32_t zd_top = INT32_MAX; zd_top = zd_top + 1;",
            "sequence 'golden'",
        ),
        (
            r"for \(uint32_t k = 0; k < FRONT_END_OUTPUTS; k\+\+\) \{\s+drift\[k\] = 0;",
            "volatile int32_t zd_shift = 32; zd_shift = 1 << zd_shift;",
            "a state whose byte 0 is",
        ),
    ],
)
def test_undefined_behaviour_that_changes_no_bit_is_a_finding(
    pattern: str, text: str, over: str, project: Path, few_ways: Callable[..., None]
) -> None:
    few_ways("host: portable")
    edit(project / SOURCE, f"({pattern})", lambda match: f"{text} {match[1]}")
    make_another_version(project)
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and "host: portable: the program was ended by signal" in outcome.told
    assert "(undefined behaviour)" in outcome.told and over in outcome.told


def test_layout_that_answers_a_damaged_state_otherwise_is_a_finding(
    project: Path, few_ways: Callable[..., None]
) -> None:
    few_ways("host: portable", "host: portable, ZD_SMALL")
    line = "if (s->delay_6_line[2] == 0x10001) { sound = 0u; }"  # which no input gives
    edit(
        project / SOURCE,
        r"(    if \(s->steps == 0u\) \{)",
        lambda match: f"#if defined(ZD_SMALL)\n    {line}\n#endif\n{match[1]}",
    )
    make_another_version(project)
    forge(project)
    outcome = Outcome(project)
    assert "host: portable" in outcome.json["backends"]
    told = "host: portable, ZD_SMALL: answers damaged and random states otherwise"
    assert outcome.code == 1 and told in outcome.told


def test_compiler_without_sanitizers_is_told_and_required_fails(
    project: Path, monkeypatch: pytest.MonkeyPatch, few_ways: object
) -> None:
    assert Outcome(project, "--require", "sanitizer").code == 0
    monkeypatch.setattr(folder_check, "can_sanitize", lambda *_: False)
    outcome = Outcome(project, "--require", "sanitizer")
    assert outcome.code == 1 and "sanitizer: is required and was not checked" in outcome.told
    assert "required, and not checked:" in outcome.told and "leave it out of" in outcome.told
    assert "not what was built" not in outcome.told
    assert "sanitizer" in [n["what"] for n in outcome.json["not_checked"]]


@pytest.mark.parametrize("name", ["int8", "reset_before", "lstm"])
def test_network_with_assembly_alone_runs_in_all_its_forms_on_cores(name: str) -> None:
    names = {way.name for way in ways.list_core_ways(load(name).model)}
    assert {"cortex-m4: ZD_SMALL", "cortex-m4: aligned", "cortex-m0plus: portable"} < names
    assert "cortex-m4: portable" not in names, "that is the one without assembly"


@pytest.mark.parametrize("how", ["cut", "nonsense", "other shapes", "other codes"])
def test_damaged_golden_vectors_are_one_message(how: str, project: Path, few_ways: object) -> None:
    path = project / "build" / "golden.npz"
    content = path.read_bytes()
    with np.load(path) as file:
        parts = {name: file[name] for name in file.files}
    if how == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif how == "nonsense":
        path.write_bytes(b"nonsense")
    elif how == "other shapes":
        np.savez_compressed(path, **{**parts, "drift": parts["drift"][:-1]})
    else:
        np.savez_compressed(path, **{**parts, "codes": parts["codes"] + 1})
    outcome = Outcome(project)
    assert outcome.code == 1 and "golden.npz: was changed" in outcome.told
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1
    assert "Traceback" not in outcome.told and "zerodrift firmware" in outcome.told


def test_stale_firmware_is_told_and_fails(project: Path, few_ways: object) -> None:
    (project / "logs" / "train_1.csv").write_text("time_s\n5\n")
    outcome = Outcome(project)
    assert outcome.code == 1 and outcome.json["bit_exact"]
    assert [s["name"] for s in outcome.json["stale"]] == ["logs/train_1.csv"]
    assert outcome.told.startswith("the firmware is stale")


def test_what_cannot_run_is_not_checked_and_required_fails(
    project: Path, monkeypatch: pytest.MonkeyPatch, few_ways: object
) -> None:
    monkeypatch.setattr(folder_check, "why_no_emulator", lambda: "unicorn is not installed")
    outcome = Outcome(project)
    assert outcome.code == 0
    assert {"what": "cortex-m4", "why": "unicorn is not installed"} in outcome.json["not_checked"]
    plain = CliRunner().invoke(cli, ["verify", "-C", str(project)])
    assert "NOT CHECKED: cortex-m4: unicorn is not installed" in plain.stdout
    outcome = Outcome(project, "--require", "cortex-m4")
    assert outcome.code == 1 and "cortex-m4: is required" in outcome.told
    outcome = Outcome(project, "--require", "cortex-m5")
    assert outcome.code == 2 and "cortex-m55" in outcome.told


def test_without_any_compiler_nothing_is_called_bit_exact(
    project: Path, monkeypatch: pytest.MonkeyPatch, few_ways: object
) -> None:
    monkeypatch.setattr(folder_check, "find_compilers", list)
    monkeypatch.setattr(folder_check, "find_cross_compilers", lambda core: [])
    outcome = Outcome(project)
    assert outcome.code == 0 and not outcome.json["bit_exact"]
    assert {"host", "header", "cortex-m4"} <= {n["what"] for n in outcome.json["not_checked"]}
    assert outcome.json["backends"] == ["reference", "onnx"]


def test_missing_manifest_fails(project: Path, few_ways: object) -> None:
    (project / "firmware" / FILE_NAME).unlink()
    outcome = Outcome(project)
    assert outcome.code == 1 and "manifest.json: is missing" in outcome.told
    assert outcome.json["bit_exact"]


def test_firmware_from_before_manifests_is_checked_by_its_bits(
    project: Path, few_ways: object
) -> None:
    (project / "firmware" / FILE_NAME).unlink()
    edit(project / HEADER, r"#define FRONT_END_MANIFEST [^\n]*\n", "")
    make_another_version(project)
    outcome = Outcome(project)
    assert outcome.code == 0 and outcome.json["bit_exact"]
    assert "manifest" in {n["what"] for n in outcome.json["not_checked"]}
    assert Outcome(project, "--require", "manifest").code == 1


def test_a_runtime_of_another_version_is_what_runs(project: Path, few_ways: object) -> None:
    """A remark added to the runtime is another file, not other bits; and it is the one compiled."""
    make_another_version(project)
    forge(project)
    assert Outcome(project).code == 0
    make_another_version(project, "#error not this one")
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and "not this one" in outcome.told and "_ID is" not in outcome.told


def test_golden_vectors_have_one_length(pristine: Path) -> None:
    golden = load_golden(pristine / "build" / "golden.npz")
    assert len(golden.codes) == len(golden.drift) == len(golden.flags) == len(golden.hidden)


def test_a_remark_is_part_of_what_an_identity_stands_for(project: Path, few_ways: object) -> None:
    """Units and limits that stand in comments are nothing that bits could tell."""
    edit(project / HEADER, r"( in )N(, -?\d+ \.\. )", r"\g<1>kN\g<2>")
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and "front_end.h:" in outcome.told and " in kN" in outcome.told


@pytest.mark.parametrize("name", [HEADER, SOURCE, "firmware/zd_network.h"])
@pytest.mark.parametrize("another", [False, True])
def test_an_identity_is_that_of_the_text_in_any_version(
    another: bool, name: str, project: Path, few_ways: object
) -> None:
    if another:
        make_another_version(project)
    path = project / name
    path.write_text(path.read_text() + "/* a remark */\n")
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1
    told = "the text of" if another else f"{path.name}:"
    assert told in outcome.told


@pytest.mark.parametrize("macro", ["FRONT_END_CODE_ID", "ZD_RUNTIME_ID"])
def test_another_identity_in_all_files_alone_is_told(
    macro: str, project: Path, few_ways: object
) -> None:
    for path in (project / "firmware").glob("*.[ch]"):
        path.write_text(
            re.sub(rf"({macro} (?:!= )?)(?:0x)?\w+", r"\g<1>0x12345678", path.read_text())
            if macro.startswith("ZD")
            else re.sub(rf"({macro} (?:!= )?)\d+", r"\g<1>12345", path.read_text())
        )
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and f"header: {macro} is" in outcome.told


def test_inputs_in_another_order_and_another_manifest_are_told(
    project: Path, few_ways: object
) -> None:
    edit(
        project / HEADER,
        r"(typedef struct \{\n)([^\n]*\n)([^\n]*\n)(.*?\} \w+_input_t)",
        r"\1\3\2\4",
    )
    edit(project / HEADER, r'"manifest.json"', '"another.json"')
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1
    names = {f["name"] for f in outcome.json["header"]}
    assert "FRONT_END_MANIFEST" in names and any(n.startswith("place of") for n in names)


@pytest.mark.parametrize("function", ["rest", "relax"])
@pytest.mark.parametrize("end", ["(-12000 - 1), 12000", "-12000, (12000 - 1)"])
@pytest.mark.parametrize("channel", ["temperature", "humidity"])
def test_what_settle_makes_of_a_first_reading_at_its_end_is_compared(
    channel: str, end: str, function: str, project: Path, few_ways: object
) -> None:
    """`settle` sees one reading; one end of one channel alone may be read otherwise there."""
    path = project / SOURCE
    before, begin, after = path.read_text().partition(f"static void front_end_{function}(")
    assert begin
    clamp = rf"(zd_clamp32\(in->{channel}), -12000, 12000\)"
    changed, count = re.subn(clamp, rf"\g<1>, {end})", after, count=1)
    assert count == 1
    path.write_text(before + begin + changed)
    make_another_version(project)
    forge(project)
    outcome = Outcome(project)
    assert outcome.code == 1 and "sequence 'golden', step 0" in outcome.told
