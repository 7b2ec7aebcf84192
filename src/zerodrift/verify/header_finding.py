"""What is wrong with a header, apart from what finds it, which loads the generator."""

from dataclasses import dataclass


@dataclass(frozen=True)
class HeaderFinding:
    """A name in the header whose value is not the model's."""

    name: str
    found: int | str | None
    """None where there is no such name."""
    expected: int | str

    def __str__(self) -> str:
        found = "is missing" if self.found is None else f"is {self.found}"
        return f"{self.name} {found}; the model gives {self.expected}"
