"""The third simulator: other sensors, by a hand that had not read what it judges.

It imports numpy and polars and nothing of zerodrift. Everything that comes out is simulated.
"""

from benchmarks.third_simulator.case import Case, Log, Size, Truth
from benchmarks.third_simulator.draw import draw_case, list_effects
from benchmarks.third_simulator.effects import EFFECTS
from benchmarks.third_simulator.families import FAMILIES
from benchmarks.third_simulator.noise import KINDS
from benchmarks.third_simulator.outside import OUTSIDE

__all__ = [
    "EFFECTS",
    "FAMILIES",
    "KINDS",
    "OUTSIDE",
    "Case",
    "Log",
    "Size",
    "Truth",
    "draw_case",
    "list_effects",
]
