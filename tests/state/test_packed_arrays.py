"""Arrays packed into one file: the same bytes, and the true reason where memory runs out."""

import io

import numpy as np
import pytest

from zerodrift.base.arrays import pack_arrays


@pytest.mark.parametrize("compressed", [True, False])
def test_arrays_come_back_and_give_the_same_bytes(compressed):
    arrays = {"a": np.arange(1000), "b": np.zeros((3, 0), np.int16)}
    packed = pack_arrays(arrays, compressed=compressed)
    assert pack_arrays(arrays, compressed=compressed) == packed
    with np.load(io.BytesIO(packed)) as stored:
        assert set(stored.files) == set(arrays)
        assert all(np.array_equal(stored[name], arrays[name]) for name in arrays)


def test_memory_that_runs_out_is_said_to_have_run_out(monkeypatch):
    def fail(file, *_, **__):
        file.write(b"half of it")
        raise MemoryError

    monkeypatch.setattr(np.lib.format, "write_array", fail)
    with pytest.raises(MemoryError):
        pack_arrays({"a": np.arange(10)}, compressed=True)


def test_other_errors_stay():
    with pytest.raises(ValueError, match="pickle"):
        pack_arrays({"a": np.array([object()])}, compressed=False)
