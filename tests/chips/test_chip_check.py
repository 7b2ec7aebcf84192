"""The check on an emulated core finds what it is there for."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest
from tests.golden.model_factory import Draw, Shape, draw_model

from zerodrift.base.errors import CheckError
from zerodrift.c_runtime.host import HostModel
from zerodrift.codegen.generate import generate
from zerodrift.verify.chip_check import check_chip

pytestmark = pytest.mark.long

if importlib.util.find_spec("unicorn") is None:
    pytest.skip("emulation needs the unicorn wheel", allow_module_level=True)


def test_equal_code_is_counted_and_an_error_on_the_core_alone_is_found(tmp_path: Path) -> None:
    model = draw_model(Shape(hidden=5, inputs=2, outputs=1), 91)
    code = generate(model)
    host = HostModel(model, code, tmp_path / "host", observe=False)
    sequences = {"noise": Draw(5).codes(-32768, 32767, 200, 2)}
    found = check_chip("cortex-m4", code, host, sequences, tmp_path / "same")
    assert found is not None and found.steps == 200
    assert 200 < found.instructions_per_step < 3000
    broken = code.source.replace('"add r4, r4, r3, lsl #1', '"add r4, r4, r3')
    assert broken != code.source, "the assembly, which the host never sees"
    with pytest.raises(CheckError, match="cortex-m4"):
        check_chip("cortex-m4", replace(code, source=broken), host, sequences, tmp_path / "broken")
