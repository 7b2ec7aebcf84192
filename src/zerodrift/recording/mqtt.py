"""Messages of an MQTT broker."""

import queue
from collections import Counter
from importlib import import_module

from zerodrift.base.errors import InputError
from zerodrift.base.extras import RECORD_MQTT, require
from zerodrift.recording.sources import LineError, LineReader, Reading, SourceText, Values, now_s

CONNECT_S = 5.0


class MqttSource:
    """Topics of a broker: a number is a column called as its topic, a JSON object one for each key.

    With a wildcard in the topic, the key of an object follows its topic: `chamber/state.degC`.

    Args:
        wanted: host, port, topic.
        columns: names, where a message is a line of numbers alone.

    Raises:
        InputError: no broker answers, or it refuses the connection.
    """

    is_rows = False
    has_times = False

    def __init__(self, wanted: SourceText, columns: tuple[str, ...]) -> None:
        self._name = f"mqtt:{wanted.place}:{wanted.number}/{wanted.detail}"
        require(RECORD_MQTT, self._name)
        client = import_module("paho.mqtt.client")
        versions = import_module("paho.mqtt.enums").CallbackAPIVersion
        self._columns = columns
        self._many = "#" in wanted.detail or "+" in wanted.detail
        self._came: queue.SimpleQueue[Reading] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._strays: Counter[str] = Counter()
        self._client = client.Client(versions.VERSION2)
        self._client.on_connect = self._greet
        self._client.on_message = self._take
        self._topic = wanted.detail
        try:
            self._client.connect(wanted.place, wanted.number)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self._name}: nobody answers ({error}); expected an MQTT broker there."
            ) from None
        self._client.loop_start()
        try:
            refused = self._answers.get(timeout=CONNECT_S)
        except queue.Empty:
            refused = f"no answer within {CONNECT_S:g} s"
        if refused:
            self.close()
            raise InputError(f"{self._name}: the broker refuses ({refused}).")

    def _greet(self, client: object, data: object, flags: object, code: object, *_: object) -> None:
        """Subscribe, at the first connection and after each that was lost."""
        failed = bool(getattr(code, "is_failure", False))
        if not failed:
            self._client.subscribe(self._topic)
        self._answers.put(str(code) if failed else "")

    def _take(self, client: object, data: object, message: object) -> None:
        topic = str(message.topic)  # type: ignore[attr-defined]
        text = bytes(message.payload).decode("utf-8", errors="replace")  # type: ignore[attr-defined]
        try:
            values = self._read(topic, text)
        except LineError as error:
            self._strays[f"{topic}: {error}"] += 1
            return
        if values:
            self._came.put(Reading(now_s(), values))

    def _read(self, topic: str, text: str) -> Values:
        try:
            return {topic: float(text)}
        except ValueError:
            pass
        values = LineReader(self._columns).read(text)
        if not values:
            raise LineError(f"'{text[:40]}' holds no number")
        return {f"{topic}.{name}" if self._many else name: v for name, v in values.items()}

    def read(self, timeout_s: float) -> list[Reading] | None:
        """Return what has come; see `LiveSource`."""
        found: list[Reading] = []
        try:
            found.append(self._came.get(timeout=timeout_s))
            while True:
                found.append(self._came.get_nowait())
        except queue.Empty:
            return found

    def explain_wait(self) -> str:
        """Return nothing: what will come is not known."""
        return ""

    def list_strays(self) -> list[str]:
        """Return which messages held no numbers, and how often they came."""
        return [f"{what}: {count} times" for what, count in self._strays.most_common(5)]

    def close(self) -> None:
        """Leave the broker."""
        self._client.disconnect()
        self._client.loop_stop()
