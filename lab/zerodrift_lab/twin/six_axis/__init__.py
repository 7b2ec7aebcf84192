"""A second, deeper twin of the six-axis sensor, built from the photo-couplers upwards.

Six couplers, an elastic structure and thirteen thermal nodes with two ways in for heat; converter
codes, forces by a calibration from simulated test weights, and CAN frames. Everything that comes
out is simulated. Nothing is shared with the code that fits models to logs.
"""

from zerodrift_lab.twin.recipe import EffectChoice, parse_choice
from zerodrift_lab.twin.six_axis.project import (
    CHANNELS,
    render_config,
    to_config,
    to_dataset,
    to_run,
)
from zerodrift_lab.twin.six_axis.protocol import (
    Protocol,
    list_protocols,
    load_protocol,
    parse_protocol,
)
from zerodrift_lab.twin.six_axis.record import Recording, record
from zerodrift_lab.twin.six_axis.sensors import draw_sensor
from zerodrift_lab.twin.six_axis.specimen import Sensor

__all__ = [
    "CHANNELS",
    "EffectChoice",
    "Protocol",
    "Recording",
    "Sensor",
    "draw_sensor",
    "list_protocols",
    "load_protocol",
    "parse_choice",
    "parse_protocol",
    "record",
    "render_config",
    "to_config",
    "to_dataset",
    "to_run",
]
