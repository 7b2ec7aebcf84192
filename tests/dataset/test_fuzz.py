"""Whatever the bytes of a log, it is read or refused in one message; nothing else gets out."""

import tempfile
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zerodrift.base.config import parse_config
from zerodrift.base.errors import InputError
from zerodrift.dataset.load import load_dataset

TOML = """\
[sensor]
name = "s"
time = "t"
temperature = "T"
sample_period_s = 1.0
[outputs.y]
measured = "y"
unit = "N"
full_scale = 1
[logs]
train = ["log.{suffix}"]
"""
FIELDS = st.one_of(
    st.sampled_from(
        ["", "nan", "1e999", "-256", "x", '"', '"a,b"', "1,2", "\xb0", " 1 ", "\0", "\n"]
    ),
    st.floats(-400, 700).map(repr),
)


def read(data: bytes, suffix: str, skip_invalid: bool):
    """Return the dataset of a log made of these bytes, or the message of its refusal."""
    with tempfile.TemporaryDirectory() as folder:
        directory = Path(folder)
        (directory / f"log.{suffix}").write_bytes(data)
        config = parse_config(TOML.format(suffix=suffix), directory / "zerodrift.toml")
        try:
            return load_dataset(config, skip_invalid)
        except InputError as error:
            return str(error)


def check(found) -> None:
    if isinstance(found, str):
        assert "log." in found or "zerodrift.toml" in found
        return
    for run in found.train:
        assert len(run) >= 10
        assert np.all(np.isfinite(run.measured))
        assert np.all(np.abs(run.temperature_degC - 150) <= 350)
        assert np.all(np.diff(run.time_s) > 0)


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(
    spoilt=st.dictionaries(st.integers(0, 119), FIELDS, max_size=6),
    skip_invalid=st.booleans(),
    ending=st.sampled_from(["\n", "\r\n", ""]),
)
def test_load_reads_or_refuses_a_csv_with_any_fields(spoilt, skip_invalid, ending):
    fields = [text for k in range(40) for text in (f"{k}.0", f"{20 + k / 10}", f"{k * k}")]
    for index, text in spoilt.items():
        fields[index] = text
    lines = ["t,T,y"] + [",".join(fields[k : k + 3]) for k in range(0, 120, 3)]
    check(read((ending or "\n").join(lines).encode("latin-1"), "csv", skip_invalid))


@settings(max_examples=100, deadline=None)
@given(data=st.binary(max_size=300), head=st.sampled_from([b"", b"t,T,y\n", b"PAR1", b"\xff\xfe"]))
def test_load_refuses_random_bytes(data, head):
    for suffix in ("csv", "parquet"):
        assert isinstance(read(head + data, suffix, False), str)


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 3000), at=st.integers(0, 3000), byte=st.integers(0, 255))
def test_load_reads_or_refuses_a_parquet_file_with_a_wrong_byte(cut, at, byte):
    k = np.arange(60.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        pl.DataFrame({"t": k, "T": 20 + k / 10, "y": k * k}).write_parquet(path)
        data = bytearray(path.read_bytes())
    data[at % len(data)] = byte
    check(read(bytes(data), "parquet", False))
    assert isinstance(read(bytes(data[: cut % len(data)]), "parquet", False), str)
