"""Nobody without the token is answered, and nothing outside of the page is served."""

import http.client
from pathlib import Path

import pytest
from tests.loop.conftest import write_project
from tests.workbench.conftest import serve

from zerodrift.base.errors import InputError


def ask(bench, path, *, method="GET", headers=None, body=None):
    connection = http.client.HTTPConnection("127.0.0.1", bench.port, timeout=300)
    connection.request(method, path, body=body, headers=headers or {})
    answer = connection.getresponse()
    text = answer.read()
    connection.close()
    return answer, text


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Return one page for all; nothing here changes it."""
    directory = tmp_path_factory.mktemp("served") / "cell"
    directory.mkdir()
    write_project(directory, runs=2)
    with serve(directory) as served:
        yield served


@pytest.mark.parametrize(
    "path", ["/", "/?token=", "/?token=wrong", "/_dash-layout", "/report.html"]
)
def test_request_without_the_token_is_refused(bench, path):
    answer, text = ask(bench, path)
    assert answer.status == 403
    assert b"cell" not in text


def test_token_opens_the_page_and_its_cookie_what_belongs_to_it(bench):
    answer, _ = ask(bench, f"/?token={bench.token}")
    assert answer.status == 200
    cookie = answer.getheader("Set-Cookie")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert "default-src 'none'" in answer.getheader("Content-Security-Policy")
    assert ask(bench, "/_dash-layout", headers={"Cookie": cookie.split(";")[0]})[0].status == 200


def test_server_listens_on_this_machine_alone(bench):
    assert bench._early.listener.getsockname()[0] == "127.0.0.1"


def test_another_host_name_is_refused_even_with_the_token(bench):
    answer, _ = ask(bench, f"/?token={bench.token}", headers={"Host": "evil.example"})
    assert answer.status == 400


def test_another_page_is_refused_even_with_the_token(bench):
    headers = {"Origin": "http://evil.example"}
    answer, _ = ask(
        bench, f"/upload?token={bench.token}&name=a.csv", method="POST", headers=headers
    )
    assert answer.status == 403


@pytest.mark.parametrize(
    "path",
    [
        "/../zerodrift.toml",
        "/..%2fzerodrift.toml",
        "/assets/../../zerodrift.toml",
        "/assets/..%2f..%2fapp.py",
        "/assets/%2e%2e/app.py",
        "/zerodrift.toml",
        "/logs/run_0.csv",
        "/_dash-component-suites/dash/..%2f..%2f..%2fetc/passwd",
    ],
)
def test_no_file_of_project_or_machine_is_served(bench, path):
    answer, text = ask(bench, f"{path}?token={bench.token}")
    assert b"[sensor]" not in text
    assert b"root:" not in text
    assert b"def " not in text
    # Paths that are no file of the page get the page itself, which shows nothing of them.
    assert answer.status in (200, 400, 404, 500)


def test_button_is_pressed_with_the_token_alone(bench):
    answer, _ = ask(bench, "/press", method="POST", body=b'{"button": "undo"}')
    assert answer.status == 403
    assert bench.place.message is None


@pytest.mark.parametrize("body", [b"", b"[]", b'{"button": "format"}', b'{"button": ["undo"]}'])
def test_press_of_what_is_no_button_does_nothing(bench, body):
    headers = {"Content-Type": "application/json"}
    path = f"/press?token={bench.token}"
    answer, text = ask(bench, path, method="POST", body=body, headers=headers)
    assert answer.status == 400
    assert b"expected" in text
    assert bench.place.message is None


def upload(bench, name, body, headers=None):
    from urllib.parse import quote

    path = f"/upload?token={bench.token}&name={quote(name)}"
    return ask(bench, path, method="POST", body=body, headers=headers)


@pytest.fixture
def empty(tmp_path):
    directory = tmp_path / "new"
    directory.mkdir()
    with serve(directory) as bench:
        yield bench


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("../outside.csv", "no plain file name"),
        ("..\\outside.csv", "no plain file name"),
        ("/etc/outside.csv", "no plain file name"),
        (".hidden.csv", "no plain file name"),
        ("", "no plain file name"),
        ("program.py", "is no log"),
    ],
)
def test_upload_cannot_leave_the_logs(empty, name, words):
    before = sorted(empty.place.directory.parent.rglob("*"))
    answer, text = upload(empty, name, b"time_s,x\n0,1\n")
    assert answer.status == 400
    assert words in text.decode()
    assert sorted(empty.place.directory.parent.rglob("*")) == before


def test_upload_of_two_gigabytes_is_refused_before_it_is_read(empty):
    answer, text = upload(empty, "big.csv", None, {"Content-Length": str(2 << 30)})
    assert answer.status == 400
    assert "2.1 GB" in text.decode()
    assert list(empty.place.directory.iterdir()) == []


def test_upload_replaces_nothing_and_is_whole(empty):
    assert upload(empty, "a.csv", b"time_s\n0\n")[0].status == 200
    target = empty.place.directory / "logs" / "a.csv"
    assert target.read_bytes() == b"time_s\n0\n"
    answer, text = upload(empty, "a.csv", b"other")
    assert answer.status == 400
    assert "exists already" in text.decode()
    assert target.read_bytes() == b"time_s\n0\n"


def test_upload_to_a_full_disk_leaves_nothing(empty, monkeypatch):
    def fail(self, *_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    answer, text = upload(empty, "a.csv", b"time_s\n0\n")
    assert answer.status == 400
    assert "No space left" in text.decode()
    assert list((empty.place.directory / "logs").iterdir()) == []


def test_second_workbench_on_a_directory_is_refused(bench):
    from zerodrift.workbench.server import Workbench

    with pytest.raises(InputError, match="another workbench is open"):
        Workbench(bench.place.directory)


def test_second_workbench_is_refused_on_the_command_line_too(bench, zerodrift):
    result = zerodrift("workbench", "--no-browser", "-C", bench.place.directory)
    assert result.code == 2
    assert "another workbench is open on this directory" in result.err


def test_upload_into_a_read_only_directory_is_a_message(empty, monkeypatch):
    def refuse(self, *_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    answer, text = upload(empty, "a.csv", b"time_s\n0\n")
    assert answer.status == 400
    assert "make the directory writable" in text.decode()
    assert list(empty.place.directory.iterdir()) == []


def test_directory_is_free_again_after_the_workbench(tmp_path):
    for _ in range(2):
        with serve(tmp_path):
            pass


def test_taken_port_is_refused(bench, tmp_path):
    from zerodrift.workbench.server import Workbench

    with pytest.raises(InputError, match="cannot be had"):
        Workbench(tmp_path, bench.port)
