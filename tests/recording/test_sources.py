"""Sources that are really there: a pseudo-terminal, a virtual CAN bus, a broker, a command."""

import math
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from zerodrift.base.errors import InputError
from zerodrift.recording.open_source import open_source
from zerodrift.recording.sources import LiveSource, Reading, parse_source

DBC = """VERSION ""
NS_ :
BS_:
BU_: SENSOR
BO_ 256 FZ_MEASURED: 8 SENSOR
 SG_ Raw : 0|32@1- (0.01,0) [-100|100] "N" Vector__XXX
 SG_ Drift : 32|32@1- (0.01,0) [-100|100] "N" Vector__XXX
BO_ 257 AIR: 4 SENSOR
 SG_ Celsius : 0|16@1- (0.0078125,0) [-40|125] "degC" Vector__XXX
 SG_ Raw : 16|16@1- (1,0) [0|0] "" Vector__XXX
"""


def collect(source: LiveSource, count: int, limit_s: float = 10.0) -> list[Reading]:
    """Return so many readings, or what there is at the end or after the limit."""
    found: list[Reading] = []
    until = time.monotonic() + limit_s
    while len(found) < count and time.monotonic() < until:
        some = source.read(0.1)
        if some is None:
            break
        found += some
    return found


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("usb:0", "expected one of serial:PORT"),
        ("serial:", r"expected serial:PORT\[@BAUD\]"),
        ("serial:/dev/x@fast", "'fast' is no whole number"),
        ("can:can0", "expected can:INTERFACE:CHANNEL"),
        ("mqtt:localhost", "expected mqtt:HOST"),
        ("mqtt:localhost:x/a", "'x' is no whole number"),
        ("command:", "expected command:COMMAND LINE"),
    ],
)
def test_a_source_of_no_form_says_the_forms(text: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        parse_source(text)


def test_serial_over_a_pseudo_terminal() -> None:
    pytest.importorskip("serial", reason="the extra 'record' is not installed")
    if not hasattr(os, "openpty"):
        pytest.skip("no pseudo-terminals here")
    mine, theirs = os.openpty()
    source = open_source(f"serial:{os.ttyname(theirs)}@9600", (), None)
    try:
        os.write(mine, b"T,p\r\n20.5,1")
        time.sleep(0.5)  # longer than the port waits: the line comes in two parts
        os.write(mine, b"013\r\nhello\r\n21.5,1014\r\n")
        got = collect(source, 2)
        assert [reading.values for reading in got] == [
            {"T": 20.5, "p": 1013.0},
            {"T": 21.5, "p": 1014.0},
        ]
        assert source.list_strays() == [
            "1 line was no row; the first: 'hello' has 1 values; expected 2"
        ]
    finally:
        source.close()
        os.close(mine)
        os.close(theirs)


def test_a_port_that_is_not_there() -> None:
    pytest.importorskip("serial", reason="the extra 'record' is not installed")
    with pytest.raises(InputError, match=r"cannot be opened .*; expected a serial port"):
        open_source("serial:/dev/no-such-port", (), None)


def test_can_over_a_virtual_bus(tmp_path: Path) -> None:
    can = pytest.importorskip("can", reason="the extra 'record' is not installed")
    pytest.importorskip("cantools", reason="the extra 'record' is not installed")
    path = tmp_path / "sensor.dbc"
    path.write_text(DBC)
    source = open_source("can:virtual:record-test", (), path)
    sender = can.Bus(interface="virtual", channel="record-test")
    try:
        for identifier, content in (
            (256, (1234).to_bytes(4, "little") + (-5).to_bytes(4, "little", signed=True)),
            (999, b"\0"),
            (257, (2560).to_bytes(2, "little") + b"\7\0"),
            (257, b"\0"),
        ):
            sender.send(can.Message(arbitration_id=identifier, data=content, is_extended_id=False))
        first, second = collect(source, 2)
        assert first.values == {"FZ_MEASURED.Raw": 12.34, "Drift": -0.05}
        assert second.values == {"Celsius": 20.0, "AIR.Raw": 7.0}
        source.read(0.2)
        told = source.list_strays()
        assert len(told) == 2 and "frame 0x3e7 is not in the DBC file: 1 times" in told
        assert any("frame 0x101 cannot be decoded" in each for each in told)
    finally:
        sender.shutdown()
        source.close()


def test_can_without_or_with_a_wrong_dbc(tmp_path: Path) -> None:
    pytest.importorskip("cantools", reason="the extra 'record' is not installed")
    with pytest.raises(InputError, match="expected --dbc FILE"):
        open_source("can:virtual:x", (), None)
    with pytest.raises(InputError, match="there is no such file"):
        open_source("can:virtual:x", (), tmp_path / "none.dbc")
    (tmp_path / "bad.dbc").write_text("no dbc at all {")
    with pytest.raises(InputError, match="is no DBC file"):
        open_source("can:virtual:x", (), tmp_path / "bad.dbc")
    with pytest.raises(InputError, match=r"is for a source can:"):
        open_source("-", (), tmp_path / "bad.dbc")
    (tmp_path / "good.dbc").write_text(DBC)
    with pytest.raises(InputError, match="cannot be opened"):
        open_source("can:no-such-interface:x", (), tmp_path / "good.dbc")


@pytest.fixture
def broker() -> Iterator[int]:
    """Start a broker on loopback; give its port."""
    pytest.importorskip("paho.mqtt.client", reason="the extra 'record' is not installed")
    program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed: make setup-record")
    with socket.socket() as free:
        try:
            free.bind(("127.0.0.1", 0))
        except OSError:
            pytest.skip("no loopback here")
        port = int(free.getsockname()[1])
    process = subprocess.Popen(
        [program, "-p", str(port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    for _ in range(100):
        try:
            socket.create_connection(("127.0.0.1", port), 0.2).close()
            break
        except OSError:
            time.sleep(0.1)
    else:
        process.kill()
        pytest.skip("mosquitto cannot be reached on loopback")
    yield port
    process.terminate()
    process.wait()


@pytest.mark.long
def test_mqtt_of_a_real_broker(broker: int) -> None:
    from paho.mqtt import publish

    source = open_source(f"mqtt:127.0.0.1:{broker}/chamber/#", (), None)
    try:
        time.sleep(0.3)
        publish.multiple(
            [
                ("chamber/degC", "20.25", 1, False),
                ("other/degC", "99", 1, False),
                ("chamber/state", '{"fan": 1, "door": {"open": false}}', 1, False),
                ("chamber/note", "warm up", 1, False),
            ],
            hostname="127.0.0.1",
            port=broker,
        )
        got = [reading.values for reading in collect(source, 2)]
        assert got == [
            {"chamber/degC": 20.25},
            {"chamber/state.fan": 1.0, "chamber/state.door.open": 0.0},
        ]
        source.read(0.5)
        assert "chamber/note" in source.list_strays()[0]
    finally:
        source.close()


def test_nobody_answers() -> None:
    pytest.importorskip("paho.mqtt.client", reason="the extra 'record' is not installed")
    with pytest.raises(InputError, match="nobody answers"):
        open_source("mqtt:127.0.0.1:9/a", (), None)


def test_a_command_that_fails_is_told_after_its_rows() -> None:
    code = "print('a=1'); import sys; sys.stdout.flush(); sys.exit(3)"
    source = open_source(f'command:"{sys.executable}" -c "{code}"', (), None)
    try:
        assert collect(source, 1)[0].values == {"a": 1.0}
        with pytest.raises(InputError, match="ended with exit code 3"):
            collect(source, 1)
    finally:
        source.close()
    with pytest.raises(InputError, match="cannot be started"):
        open_source("command:no-such-program-anywhere", (), None)


def test_bytes_without_an_end_of_line_fill_no_memory() -> None:
    code = "import sys; sys.stdout.write('x' * 50_000 + '\\na=1\\n')"
    source = open_source(f'command:"{sys.executable}" -c "{code}"', (), None)
    try:
        (reading,) = collect(source, 1)
        assert reading.values == {"a": 1.0}
        assert "10000 bytes came without an end of line" in source.list_strays()[0]
    finally:
        source.close()


def test_a_time_of_arrival_is_that_of_the_line() -> None:
    code = "import time; print('a=1', flush=True); time.sleep(0.5); print('a=2', flush=True)"
    source = open_source(f'command:"{sys.executable}" -c "{code}"', (), None)
    try:
        first, second = collect(source, 2)
        assert 0.3 < second.at_s - first.at_s < 5.0
        assert math.isclose(first.values["a"], 1.0)
    finally:
        source.close()


def test_nobody_is_left_listening() -> None:
    before = threading.active_count()
    source = open_source(f'command:"{sys.executable}" -c "pass"', (), None)
    assert collect(source, 1) == []
    source.close()
    assert threading.active_count() <= before + 1
