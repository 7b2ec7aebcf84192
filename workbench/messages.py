"""What the page tells its user in words of its own."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Message:
    """Something to tell the user."""

    text: str
    is_error: bool = True


def explain_guess(told: Mapping[str, Any]) -> str:
    """Return what `init` guessed, and what of it to check."""
    outputs = "; ".join(
        f"{name} in {o['unit']}: {o['measured']} against {o['reference'] or 0}, full scale "
        f"{o['full_scale']:g} {o['unit']}"
        for name, o in told["outputs"].items()
    )
    lines = [
        f"Guessed: time {told['time']}, a row every {told['sample_period_s']:g} s; temperature "
        f"{told['temperature']}; {outputs}.",
        *(f"Check: {check}" for check in told["check"]),
        "All of it stands in zerodrift.toml and can be edited there; the page follows.",
    ]
    return "\n".join(lines)
