"""The sensor's CAN frames of a run as candump text, and the DBC file that decodes them.

Per sample there are two frames of raw values (converter codes, thermometer code, counter) and one
`<NAME>_MEASURED` per output, laid out as the firmware's own: raw value and drift, int32 counts,
little-endian. The simulated sensor has no compensation yet, so the drift in them is zero.
"""

import numpy as np
from numpy.typing import NDArray

from zerodrift_lab.twin.sensor import OUTPUTS, TEMPERATURE_LSB, UNITS
from zerodrift_lab.twin.six_axis.record import Recording

Array = NDArray[np.float64]

FIRST_CODES_ID = 0x0F0
"""Frame of adc_1 to adc_4; the next one holds adc_5, adc_6, thermometer and counter."""
FIRST_OUTPUT_ID = 0x100
"""First of two identifiers per output, as in the DBC file of a generated package."""
#: Counts per N or Nm: the power of ten that gives full scale about a million of them.
COUNTS_PER_UNIT: Array = np.array([1e4, 1e4, 1e3, 1e5, 1e5, 1e5])
FRAME_S = 0.0003
"""Between two frames: some 130 bits at 500 kbit/s, rounded up."""


def _list_payloads(run: Recording) -> list[tuple[int, NDArray[np.uint8]]]:
    """Return (identifier, payloads [n, 8]) of every frame of a sample, in the order of sending."""
    count = run.time_s.size
    codes = run.adc.astype("<u2")
    thermometer = np.round(run.temperature_degC / TEMPERATURE_LSB).astype("<i2")
    counter = (np.arange(count) % 65536).astype("<u2")
    first = np.ascontiguousarray(codes[:, :4]).view(np.uint8)
    second = np.concatenate(
        [
            np.ascontiguousarray(codes[:, 4:]).view(np.uint8),
            thermometer[:, None].view(np.uint8),
            counter[:, None].view(np.uint8),
        ],
        axis=1,
    )
    frames = [(FIRST_CODES_ID, first), (FIRST_CODES_ID + 1, second)]
    for k in range(len(OUTPUTS)):
        raw = np.round(run.measured[:, k] * COUNTS_PER_UNIT[k]).astype("<i4")
        both = np.stack([raw, np.zeros_like(raw)], axis=1).astype("<i4")
        frames.append((FIRST_OUTPUT_ID + 2 * k, np.ascontiguousarray(both).view(np.uint8)))
    return frames


def render_candump(run: Recording, interface: str = "can0") -> str:
    """Return the frames of a run as `candump -L` writes them, time from the start of the run."""
    frames = _list_payloads(run)
    payloads = [payload.tobytes().hex().upper() for _, payload in frames]
    lines = []
    for n, time_s in enumerate(run.time_s.tolist()):
        for place, (identifier, _) in enumerate(frames):
            data = payloads[place][16 * n : 16 * n + 16]
            sent_s = time_s + place * FRAME_S
            lines.append(f"({sent_s:.6f}) {interface} {identifier:03X}#{data}")
    return "\n".join(lines) + "\n"


def render_dbc() -> str:
    """Return the DBC file of the simulated sensor's frames."""
    lines = ['VERSION "simulated"', "", "NS_ :", "", "BS_:", "", "BU_: SENSOR", ""]
    for place, names in enumerate((range(1, 5), range(5, 7))):
        lines.append(f"BO_ {FIRST_CODES_ID + place} CODES_{place + 1}: 8 SENSOR")
        for bit, number in enumerate(names):
            lines.append(f' SG_ Adc{number} : {16 * bit}|16@1+ (1,0) [0|65535] "" Vector__XXX')
        if place == 1:
            low, high = -(2**15) * TEMPERATURE_LSB, (2**15 - 1) * TEMPERATURE_LSB
            lines += [
                f" SG_ Temperature : 32|16@1- ({TEMPERATURE_LSB!r},0) [{low!r}|{high!r}] "
                '"degC" Vector__XXX',
                ' SG_ Counter : 48|16@1+ (1,0) [0|65535] "" Vector__XXX',
            ]
        lines.append("")
    for k, (name, unit) in enumerate(zip(OUTPUTS, UNITS, strict=True)):
        counts = float(COUNTS_PER_UNIT[k])
        low, high = -(2**31) / counts, (2**31 - 1) / counts
        value = f'({1.0 / counts!r},0) [{low!r}|{high!r}] "{unit}" Vector__XXX'
        lines += [
            f"BO_ {FIRST_OUTPUT_ID + 2 * k} {name.upper()}_MEASURED: 8 SENSOR",
            f" SG_ Raw : 0|32@1- {value}",
            f" SG_ Drift : 32|32@1- {value}",
            "",
        ]
    return "\n".join(lines)
