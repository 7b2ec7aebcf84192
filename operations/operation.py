"""An operation as effects call it: its float meaning, and how it becomes integer nodes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from zerodrift.operations.arithmetic import Array
from zerodrift.operations.formats import Signal


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

    def name_arguments(
        self, given: Sequence[object], named: Mapping[str, object]
    ) -> dict[str, object]:
        """Return the arguments of a call by their names.

        Raises:
            TypeError: one is missing, or there are too many.
        """
        names = (*self.signals, *self.constants)
        arguments = {**dict(zip(names, given, strict=False)), **named}
        if set(arguments) != set(names) or len(given) + len(named) != len(names):
            raise TypeError(
                f"{self.name}({', '.join(names)}) was given {len(given)} arguments"
                + "".join(f" and {name}" for name in named)
            )
        return arguments
