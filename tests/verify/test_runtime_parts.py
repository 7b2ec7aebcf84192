"""A firmware folder gets the files of the runtime that its model includes."""

import re
from pathlib import Path

import numpy as np
import pytest
from tests.golden.vectors import load
from tests.verify.conftest import write_firmware

from zerodrift.base.config import load_config
from zerodrift.c_runtime.compilers import RUNTIME_FILES, find_compiler, list_runtime
from zerodrift.c_runtime.host import HostModel, render_sources
from zerodrift.codegen.generate import generate
from zerodrift.codegen.identity import identify_runtime
from zerodrift.export.golden import compute_golden
from zerodrift.verify.firmware import write_artefacts
from zerodrift.verify.manifest import check_manifest
from zerodrift_proof.known_runtime import is_known

ROOT = Path(__file__).parents[2]
EVERY = {path.name: path.read_text(encoding="utf-8") for path in RUNTIME_FILES}
NETWORK = {name for name in EVERY if re.match(r"zd_(network|gru|tanh)", name)}
ALWAYS = {"zd_runtime.h", "zd_runtime.c", "zd_signals.h"}
LSTM = {"zd_lstm.h", "zd_lstm_rows.h"}
INCLUDED = {
    "effects": ALWAYS | NETWORK | {"zd_exp2.h"},
    "ordinary": ALWAYS | NETWORK,
    "layer_norm": ALWAYS | NETWORK | LSTM | {"zd_layer_norm.h"},
    "lstm": ALWAYS | NETWORK | LSTM,
}


@pytest.mark.parametrize("name", INCLUDED)
def test_a_model_has_what_it_includes_beside_it(name: str, tmp_path: Path) -> None:
    code = generate(load(name).model)
    texts = render_sources(code)
    assert {each for each in texts if each.startswith("zd_")} == INCLUDED[name]
    HostModel(load(name).model, code, tmp_path, find_compiler(), ("-O0",), observe=False)


def test_every_file_of_the_runtime_is_reached_by_some_model() -> None:
    assert set.union(*INCLUDED.values()) == set(EVERY)


def test_a_model_that_includes_less_leaves_no_files_of_another(tmp_path: Path) -> None:
    project = write_firmware(tmp_path / "p", load("lstm").model)
    assert (project / "firmware/zd_lstm.h").is_file()
    (project / "firmware/zd_own.h").write_text("/* the user's */")
    model = load("ordinary").model
    golden = compute_golden(model, np.zeros((2, len(model.channels)), dtype=model.code_type))
    write_artefacts(load_config(project), model, generate(model), "{}", golden)
    there = {path.name for path in (project / "firmware").glob("zd_*")}
    assert there == ALWAYS | NETWORK | {"zd_own.h"}
    assert not check_manifest(load_config(project)).findings


def test_part_of_a_runtime_is_known_if_nothing_that_is_included_lacks() -> None:
    part = list_runtime('#include "zd_runtime.h"')
    assert is_known(part) and is_known(EVERY)
    model = '#include "zd_runtime.h"\n#include "zd_network.h"\n'
    assert not is_known({**part, "m.c": model})
    assert is_known({**list_runtime(model), "m.c": model})
    assert not is_known({**part, "zd_runtime.h": part["zd_runtime.h"] + " "})
    assert not is_known({**part, "zd_other.h": ""})
    assert not is_known({name: text for name, text in part.items() if name != "zd_signals.h"})
    assert not is_known({})


@pytest.mark.parametrize("name", sorted(ALWAYS))
def test_part_of_a_runtime_is_held_against_the_identity_of_the_whole(name: str) -> None:
    part = {each: EVERY[each] for each in ALWAYS}
    assert identify_runtime(part) == part and identify_runtime(EVERY) == EVERY
    changed = {**part, name: part[name] + "/* a remark */\n"}
    assert identify_runtime(changed) != changed


def test_the_permission_names_every_file_that_goes_out() -> None:
    text = (ROOT / "GENERATED-CODE-EXCEPTION.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(zd_\w+\.[ch])`", text))
    assert named == set(EVERY)
