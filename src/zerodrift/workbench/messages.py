"""What the page tells its user in words of its own."""

from dataclasses import dataclass

from zerodrift.report.results import InitResult


@dataclass(frozen=True)
class Message:
    """Something to tell the user."""

    text: str
    is_error: bool = True


def explain_guess(guess: InitResult) -> str:
    """Return what `init` guessed, and what of it to check."""
    outputs = "; ".join(
        f"{name} in {o.unit}: {o.measured} against {o.reference or 0}, full scale "
        f"{o.full_scale:g} {o.unit}"
        for name, o in guess.outputs.items()
    )
    lines = [
        f"Guessed: time {guess.time}, a row every {guess.sample_period_s:g} s; temperature "
        f"{guess.temperature}; {outputs}.",
        *(f"Check: {check}" for check in guess.check),
        "All of it stands in zerodrift.toml and can be edited there; the page follows.",
    ]
    return "\n".join(lines)
