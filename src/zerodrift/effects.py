"""The parts of a user's own effect; see docs/how-to/write-an-effect.md.

Example:
    >>> from zerodrift.effects import Effect, Feature, Parameter, register
"""

from zerodrift.physics.catalogue import register
from zerodrift.physics.effect import Effect, Feature, Parameter

__all__ = ["Effect", "Feature", "Parameter", "register"]
