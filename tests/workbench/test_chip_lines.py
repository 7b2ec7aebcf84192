"""What the page is given to run the firmware's own C: module, runs, and a live sensor's lines."""

import json
import shutil
from dataclasses import replace

import pytest
from tests.workbench.conftest import serve
from tests.workbench.test_security import ask
from tests.workbench.test_workplace import settle

from zerodrift.base.errors import InputError
from zerodrift.export.integer_model import FLAG_NO_READING
from zerodrift.workbench.chip import LiveChip

HEADER = "time_s,temperature_degC,Fz_N,Mx_Nm"


def test_live_lines_are_the_logs_columns_in_any_form(chip):
    folder = chip.place.chip_folder
    lines = LiveChip(chip.place.directory, folder)
    first = lines.take(f"{HEADER}\n0,25.0,3,4\n1,25.5,3,4\n")
    assert len(first.codes) == 2
    objects = LiveChip(chip.place.directory, folder)
    same = objects.take(
        "".join(
            json.dumps({"temperature_degC": t, "Fz_N": 3, "Mx_Nm": 4}) + "\n" for t in (25.0, 25.5)
        )
    )
    assert same == first
    lacking = lines.take("2,nan,3,nan\n")
    assert lacking.codes == ((-32768,),)
    assert lacking.flags[0] & FLAG_NO_READING
    assert lacking.measured == ((3.0, None),)
    with pytest.raises(InputError, match="the model reads temperature_degC"):
        objects.take('{"Fz_N": 3}\n')


def test_lacking_value_is_held_where_no_code_says_so(chip):
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    channels = tuple(replace(channel, no_reading=None) for channel in lines._model.channels)
    lines._model = replace(lines._model, channels=channels)
    with pytest.raises(InputError, match="no reading in the first line"):
        lines.take(f"{HEADER}\n0,nan,3,4\n")
    first = lines.take("1,25.5,3,4\n")
    assert lines.take("2,nan,3,4\n").codes == first.codes


def test_changed_c_is_the_one_that_runs(built, tmp_path):
    """What lies in the folder is compiled, not what would be generated."""

    directory = tmp_path / "cell"
    shutil.copytree(built.directory, directory)
    source = directory / "firmware" / "cell.c"
    source.write_text(source.read_text() + "\nint broken = ;\n")
    with serve(directory) as bench:
        settle(bench.place)
        bench.place.load_chip()
        settle(bench.place)
        assert bench.place.chip is None
        assert "broken" in bench.place.message.text


def test_worker_can_reach_nothing_and_the_page_no_other_worker(chip):
    token = f"token={chip.token}"
    worker, text = ask(chip, f"/assets/chip_worker.js?{token}")
    policy = "default-src 'none'; script-src 'wasm-unsafe-eval'"
    assert worker.getheader("Content-Security-Policy") == policy
    assert b"WebAssembly" in text
    page, text = ask(chip, f"/?{token}")
    assert "worker-src 'self';" in page.getheader("Content-Security-Policy")
    assert b"assets/chip.js" in text
    assert b"chip_worker.js" not in text


def test_module_runs_and_lines_are_for_the_owner_of_the_token(chip):
    paths = ("/chip/wasm", "/chip/run?number=0", "/chip/lines")
    for path, method in zip(paths, ("GET", "GET", "POST"), strict=True):
        answer, _ = ask(chip, path, method=method)
        assert answer.status == 403
    assert ask(chip, f"/chip/wasm?token={chip.token}")[1][:4] == b"\0asm"
    for number in ("", "99", "-1", "../chip"):
        answer, _ = ask(chip, f"/chip/run?number={number}&token={chip.token}")
        assert answer.status == 404
    answer, text = ask(
        chip, f"/chip/lines?anew=1&token={chip.token}", method="POST", body=b'{"Fz_N": 1}\n'
    )
    assert answer.status == 400
    assert b"the model reads temperature_degC" in text


def test_without_firmware_there_is_nothing_to_run(project):
    with serve(project.directory) as bench:
        settle(bench.place)
        assert ask(bench, f"/chip/wasm?token={bench.token}")[0].status == 404
        bench.place.load_chip()
        settle(bench.place)
        assert "model.json" in bench.place.message.text
        with pytest.raises(InputError, match="no C is in the page"):
            bench.place.answer_live("1,2\n", anew=True)
