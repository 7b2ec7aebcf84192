"""What the page is given to run the firmware's own C: module, runs, and a live sensor's lines."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from tests.workbench.conftest import serve
from tests.workbench.test_security import ask
from tests.workbench.test_workplace import settle

from zerodrift.base.errors import InputError
from zerodrift.dataset.sampling import plan_stretches
from zerodrift.export.integer_model import FLAG_NO_READING
from zerodrift.workbench.chip import LiveChip

HEADER = "time_s,temperature_degC,Fz_N,Mx_Nm"


@pytest.mark.long
def test_live_lines_are_the_logs_columns_in_any_form(chip):
    folder = chip.place.chip_folder
    lines = LiveChip(chip.place.directory, folder)
    first = lines.take(f"{HEADER}\n" + "".join(f"{t},{25 + 0.5 * t},3,4\n" for t in range(6)))
    assert len(first.codes) == 6
    objects = LiveChip(chip.place.directory, folder)
    same = objects.take(
        "".join(
            json.dumps({"time_s": t, "temperature_degC": 25.0 + 0.5 * t, "Fz_N": 3, "Mx_Nm": 4})
            + "\n"
            for t in range(6)
        )
    )
    assert same == first
    lacking = lines.take("6,nan,3,nan\n")
    assert lacking.codes == ((-32768,),)
    assert lacking.flags[0] & FLAG_NO_READING
    assert lacking.measured == ((3.0, None),)
    with pytest.raises(InputError, match="the model reads temperature_degC"):
        objects.take('{"Fz_N": 3}\n')


@pytest.mark.long
def test_lacking_value_is_held_where_no_code_says_so(chip):
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    channels = tuple(replace(channel, no_reading=None) for channel in lines._model.channels)
    lines._model = replace(lines._model, channels=channels)
    with pytest.raises(InputError, match="no reading in the first line"):
        lines.take(f"{HEADER}\n0,nan,3,4\n" + "".join(f"{t},25,3,4\n" for t in range(1, 6)))
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    lines._model = replace(lines._model, channels=channels)
    first = lines.take(f"{HEADER}\n" + "".join(f"{t},25.5,3,4\n" for t in range(6)))
    assert lines.take("6,nan,3,4\n").codes == first.codes[:1]


def write_rows(seconds, interval_s):
    """Return rows of a ramp of 0.1 degC/s, so many seconds long."""
    times = (round(k * interval_s, 6) for k in range(round(seconds / interval_s) + 1))
    return "".join(f"{t:.6f},{25 + 0.1 * t:.6f},{3 + 0.01 * t:.6f},4\n" for t in times)


@pytest.mark.long
def test_faster_rows_become_the_means_of_logs(chip):
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    told = lines.take(f"{HEADER}\n{write_rows(20, 0.1)}")
    assert len(told.codes) == 20
    time_s = np.arange(201) * 0.1
    (stretch,), _ = plan_stretches(time_s, 0, 201, 1.0)
    wanted = stretch.resample(3.0 + 0.01 * time_s)
    assert [row[0] for row in told.measured] == pytest.approx(wanted[:20].tolist(), abs=1e-9)
    assert told.sampling == "a row every 0.1 s: each step is their mean over 1 s"
    assert not told.warns


def test_slower_rows_are_held_and_said_so(chip):
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    told = lines.take(f"{HEADER}\n{write_rows(20, 2.0)}")
    assert len(told.codes) == 21
    wanted = [3.0 + 0.02 * (k // 2) for k in range(21)]
    assert [row[0] for row in told.measured] == pytest.approx(wanted, abs=1e-9)
    assert "a row every 2 s, slower than the model's period of 1 s" in told.sampling and told.warns


def test_rows_at_the_period_are_steps_as_they_are(chip):
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    rng = np.random.default_rng(0)
    times = np.arange(50) + rng.uniform(-0.2, 0.2, 50)
    rows = "".join(f"{t:.4f},25,{k},4\n" for k, t in enumerate(times))
    told = lines.take(f"{HEADER}\n{rows}")
    assert [row[0] for row in told.measured] == [float(k) for k in range(50)]
    assert told.sampling == ""


def test_rows_without_times_are_taken_as_they_arrive(chip):
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    steps = []
    lines.take("temperature_degC,Fz_N,Mx_Nm\n", 0.0)
    for k in range(1, 101):  # ten rows a second, five at a time
        steps += lines.take("".join(f"25,{5 * k + i},4\n" for i in range(5)), 0.5 * k).measured
    assert 47 <= len(steps) <= 50
    assert np.diff([row[0] for row in steps]) == pytest.approx(np.full(len(steps) - 1, 10.0))
    slow = LiveChip(chip.place.directory, chip.place.chip_folder)
    slow.take("temperature_degC,Fz_N,Mx_Nm\n", 0.0)
    for k in range(1, 10):
        told = slow.take(f"25,{k},4\n", 3.0 * k)
    assert told.warns and "a row every 3 s" in told.sampling


def test_a_silence_is_left_out_and_a_device_may_begin_again(chip):
    lines = LiveChip(chip.place.directory, chip.place.chip_folder)
    times = (*range(6), 500, 501, 0, 1)
    rows = "".join(f"{t},25,{number},4\n" for number, t in enumerate(times))
    told = lines.take(f"{HEADER}\n{rows}")
    assert [row[0] for row in told.measured] == [float(k) for k in range(10)]
    assert "1 silences of more than 100 steps left out" in told.sampling and told.warns
    told = lines.take("nan,25,7,4\n")
    assert told.codes == () and "no time in 'time_s'" in told.first_stray


@pytest.mark.long
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


@pytest.mark.long
def test_without_firmware_there_is_nothing_to_run(project):
    with serve(project.directory) as bench:
        settle(bench.place)
        assert ask(bench, f"/chip/wasm?token={bench.token}")[0].status == 404
        bench.place.load_chip()
        settle(bench.place)
        assert "model.json" in bench.place.message.text
        with pytest.raises(InputError, match="no C is in the page"):
            bench.place.answer_live("1,2\n", anew=True)
