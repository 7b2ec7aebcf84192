"""Files that were made to do harm: sheets without end, numbers from elsewhere, formulas."""

from pathlib import Path

import numpy as np
import pytest

from zerodrift.base.errors import InputError
from zerodrift.dataset.formats.registry import find_format, read_tables


def read(path: Path) -> object:
    known = find_format(path)
    assert known is not None
    return read_tables(path, path.name, known)


def test_two_cells_in_opposite_corners_are_told(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = 1, 2
    book.active.title = "Messung"
    book.save(tmp_path / "log.xlsx")
    with pytest.raises(InputError, match=r"'Messung' spans more than 16,777,216 cells.*Ctrl\+End"):
        read(tmp_path / "log.xlsx")


def test_a_sheet_just_beyond_the_cap_is_told_and_one_within_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    excel = pytest.importorskip("zerodrift.dataset.formats.excel")
    book = openpyxl.Workbook()
    for row in range(10):
        book.active.append([row, 2 * row])
    book.save(tmp_path / "log.xlsx")
    monkeypatch.setattr(excel, "MOST_CELLS", 20)
    (table,) = read(tmp_path / "log.xlsx")  # type: ignore[misc, attr-defined]
    assert table.text.read_text().splitlines()[3] == "3.0\t6.0"
    monkeypatch.setattr(excel, "MOST_CELLS", 19)
    with pytest.raises(InputError, match="more than 19 cells"):
        read(tmp_path / "log.xlsx")


def write_hdf5(path: Path, kind: str) -> None:
    h5py = pytest.importorskip("h5py")
    secret = path.with_name("secret.bin")
    np.arange(8.0).tofile(secret)
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(8.0)
        if kind == "external storage":
            whole = [(str(secret), 0, h5py.h5f.UNLIMITED)]
            file.create_dataset("x", shape=(8,), dtype="f8", external=whole)
        elif kind == "external link":
            file.create_group("deep")["x"] = h5py.ExternalLink(str(secret), "/x")
        elif kind == "virtual":
            layout = h5py.VirtualLayout(shape=(8,), dtype="f8")
            layout[:] = h5py.VirtualSource(str(secret), "x", shape=(8,))
            file.create_virtual_dataset("x", layout)
        elif kind == "nothing recorded":
            file.create_dataset("x", shape=(10**11,), dtype="f8", chunks=(1024,))
        else:
            file["x"] = np.arange(8.0)


@pytest.mark.parametrize("kind", ["external storage", "external link", "virtual"])
def test_numbers_from_another_file_are_refused(kind: str, tmp_path: Path) -> None:
    write_hdf5(tmp_path / "log.h5", kind)
    with pytest.raises(InputError, match=r"from another file, .*secret\.bin"):
        read(tmp_path / "log.h5")


def test_more_than_a_file_can_hold_is_refused(tmp_path: Path) -> None:
    write_hdf5(tmp_path / "log.h5", "nothing recorded")
    with pytest.raises(InputError, match="'x' claims 800,000,000,000 bytes"):
        read(tmp_path / "log.h5")


def test_an_ordinary_file_is_read(tmp_path: Path) -> None:
    write_hdf5(tmp_path / "log.h5", "ordinary")
    (table,) = read(tmp_path / "log.h5")  # type: ignore[misc, attr-defined]
    assert table.frame["x"].to_list() == list(range(8))
