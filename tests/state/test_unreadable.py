"""A file that the system does not hand out: exit code 2, and nothing is said of what it holds."""

import errno
import io
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import Result
from tests.verify.conftest import write_firmware
from zerodrift.base.files import list_own
from zerodrift_proof.certificate.check import check_certificate

Command = Callable[..., Result]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_firmware(tmp_path_factory.mktemp("built") / "project")


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Return what makes the system refuse files whose path ends so."""

    def refuse(end: str) -> None:
        def open_(path: object, *arguments: object, **options: object) -> object:
            if isinstance(path, (str, os.PathLike)) and os.fspath(path).endswith(end):
                raise OSError(errno.EIO, os.strerror(errno.EIO), os.fspath(path))
            return really(path, *arguments, **options)  # type: ignore[call-overload]

        really = io.open
        monkeypatch.setattr(io, "open", open_)

    return refuse


@pytest.mark.parametrize(
    "end", ["firmware/manifest.json", "firmware/zd_runtime.h", "logs/test.csv"]
)
def test_package_says_what_it_cannot_read(
    end: str, built: Path, refuse: Callable[[str], None], zerodrift: Command
) -> None:
    refuse(end)
    done = zerodrift("package", "cmake", "-C", built)
    assert done.code == 2 and f"{end}: cannot be " in done.err, done.err
    assert "Input/output error" in done.err
    assert "is gone" not in done.err and "not what was built" not in done.err


def test_certificate_that_cannot_be_read_is_not_refused(
    built: Path, refuse: Callable[[str], None], tmp_path: Path
) -> None:
    assert check_certificate(tmp_path / "nothing").failures
    assert check_certificate(built / "firmware").failures == ()
    refuse("zd_runtime.h")
    with pytest.raises(OSError, match="Input/output error"):
        check_certificate(built / "firmware")


def test_manifest_that_cannot_be_read_makes_no_file_foreign(
    built: Path, refuse: Callable[[str], None], tmp_path: Path
) -> None:
    assert list_own(tmp_path) == frozenset()
    assert "zd_runtime.h" in list_own(built / "firmware")
    refuse("manifest.json")
    with pytest.raises(OSError, match="Input/output error"):
        list_own(built / "firmware")
