"""The simulated six-axis sensor: logs with any set of hidden effects, and the truth about them.

Its numerical code is its own: nothing here is shared with what fits models to logs.
"""

from zerodrift_lab.twin.logger import SimulatedRun
from zerodrift_lab.twin.logs import write_logs
from zerodrift_lab.twin.project import to_config, to_dataset
from zerodrift_lab.twin.recipe import EffectChoice, Recipe, parse_choice
from zerodrift_lab.twin.simulate import Simulation, simulate

__all__ = [
    "EffectChoice",
    "Recipe",
    "SimulatedRun",
    "Simulation",
    "parse_choice",
    "simulate",
    "to_config",
    "to_dataset",
    "write_logs",
]
