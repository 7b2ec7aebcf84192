"""An operation as effects call it: its float meaning, and how it becomes integer nodes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from zerodrift.base.arrays import Array
from zerodrift.operations.signals import Signal


@dataclass(frozen=True)
class Operation:
    """An operation of the float graph: `ops.NAME(signals..., constants...)` in an effect."""

    name: str
    compute: Callable[..., Array]
    """The float meaning: signals are arrays with time along the last axis; constants by name."""
    lower: Callable[..., Signal]
    """(nodes, node, *signals): the integer meaning of a float `Node` among `FormattedNodes`."""
    signals: tuple[str, ...]
    constants: tuple[str, ...] = ()
    timed: bool = False
    """Whether `compute` is given `sample_period_s`, too."""

    @property
    def arity(self) -> int:
        """Number of arguments."""
        return len(self.signals) + len(self.constants)

    def order_arguments(
        self, given: tuple[object, ...], named: Mapping[str, object]
    ) -> tuple[object, ...]:
        """Return the arguments of a call in their order.

        Raises:
            TypeError: one is missing, or there are too many.
        """
        names = (*self.signals, *self.constants)
        rest = names[len(given) :]
        if len(given) > len(names) or set(rest) != set(named):
            raise TypeError(
                f"{self.name}({', '.join(names)}) was given {len(given)} arguments"
                + "".join(f" and {name}" for name in named)
            )
        return (*given, *(named[name] for name in rest))
