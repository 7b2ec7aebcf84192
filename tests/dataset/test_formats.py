"""Files of other kinds, by their formats' own writers: columns, units and times are right."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from tests.dataset import log_writers as made

from zerodrift.base.config import load_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.formats.registry import FORMATS, find_format
from zerodrift.dataset.guess import guess_project
from zerodrift.dataset.load import load_dataset
from zerodrift.dataset.logs import open_sources

LIBRARIES = {
    ".xlsx": ("python_calamine", "openpyxl"),
    ".h5": ("h5py",),
    ".mcap": ("mcap", "mcap_ros2"),
    ".db3": ("rosbags",),
    ".ulg": ("pyulog",),
    ".bin": ("pymavlink",),
}


def need(suffix: str) -> None:
    for name in LIBRARIES.get(suffix, ()):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"{name} is not installed: make setup-formats")


def load(folder: Path, log: str, columns: tuple[str, str, str]):
    time, temperature, force = columns
    (folder / "zerodrift.toml").write_text(
        f'[sensor]\nname = "s"\ntime = "{time}"\ntemperature = "{temperature}"\n'
        f'sample_period_s = 1.0\n[outputs.F]\nmeasured = "{force}"\nunit = "N"\n'
        f'full_scale = 100\n[logs]\ntrain = ["{log}"]\n'
    )
    return load_dataset(load_config(folder))


def check(run, force_tolerance=0.0, late_s=0.0) -> None:
    """Compare a run with what was written; a topic that is late is interpolated."""
    begin = round(run.time_s[0] - np.floor(run.time_s[0]), 6) >= 0 and len(run) < made.COUNT
    first = made.COUNT - len(run) if begin else 0
    force = made.FORCE[first:]
    np.testing.assert_allclose(run.measured[:, 0], force, rtol=0, atol=force_tolerance)
    expected = np.interp(made.TIME[first:] - late_s, made.TIME, made.TEMPERATURE)
    np.testing.assert_allclose(run.temperature_degC, expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(np.diff(run.time_s), 1.0, atol=1e-6)


@pytest.mark.parametrize("name", made.WRITERS)
def test_file_by_its_own_writer_is_read(tmp_path, name):
    need(Path(name).suffix)
    made.WRITERS[name](tmp_path / name)
    (run,) = load(tmp_path, name, made.COLUMNS.get(name, made.NAMES)).train
    single = 1e-5 if name in ("log.ulg", "log.bin") else 0.0
    check(run, single, late_s=0.4 if name == "log.mcap" else 0.0)
    if name in ("json.mcap", "log.mcap") or "time" in made.COLUMNS.get(name, made.NAMES)[:1]:
        assert run.time_s[-1] == pytest.approx(made.UNIX_S + made.COUNT - 1)


@pytest.mark.parametrize("name", made.WRITERS)
def test_init_knows_what_it_sees_in_it(tmp_path, name):
    need(Path(name).suffix)
    made.WRITERS[name](tmp_path / name)
    guess = guess_project([tmp_path / name])
    time, temperature, force = made.COLUMNS.get(name, made.NAMES)
    assert (guess.time.name, guess.temperature) == (time, temperature)
    assert [output.measured for output in guess.outputs] == [force]
    if name not in ("log.ulg", "log.bin"):  # which name no unit
        assert guess.outputs[0].unit == "N"
    assert guess.sample_period_s == 1.0


def test_rosbag2_folder_is_read(tmp_path):
    need(".db3")
    made.write_rosbag2(tmp_path / "bag")
    for log in ("bag", "bag/bag.db3"):
        (run,) = load(tmp_path, log, ("time_s", "temperature", "wrench.force.z")).train
        check(run)
        assert run.time_s[0] == made.UNIX_S


def test_column_of_one_topic_among_several_is_named_with_it(tmp_path):
    need(".mcap")
    made.write_mcap(tmp_path / "log.mcap")
    columns = ("time_s", "/ft/temperature:temperature", "/ft/wrench:wrench.force.z")
    assert load(tmp_path, "log.mcap", columns).train
    with pytest.raises(InputError, match=r"in any of its 2 tables; did you mean 'wrench.force.z'"):
        load(tmp_path, "log.mcap", ("time_s", "temperature", "wrench.force.zz"))


def test_topics_without_numbers_are_refused(tmp_path):
    need(".mcap")
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("text", "protobuf", b"")
        channel = writer.register_channel("/chatter", "protobuf", schema)
        writer.add_message(channel, 0, b"hello", 0)
        writer.finish()
    with pytest.raises(InputError, match=r"no topic can be read: /chatter \(protobuf\); expected"):
        open_sources(tmp_path / "log.mcap", "log.mcap", {})


@pytest.mark.parametrize("suffix", [known.suffixes[0] for known in FORMATS])
def test_damaged_file_or_missing_library_is_told(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"nothing of the kind" * 20)
    with pytest.raises(InputError) as caught:
        open_sources(path, path.name, {})
    message = str(caught.value)
    known = find_format(path)
    is_missing = all(importlib.util.find_spec(name) is None for name in LIBRARIES[suffix][:1])
    assert (
        "pip install 'python-calamine" in message
        if is_missing
        else known.name in message or ("metadata.yaml" in message)
    )
