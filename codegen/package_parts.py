"""What packages share: headers and sources apart, and the inputs as a package's user gives them."""

from collections.abc import Mapping
from dataclasses import dataclass

from zerodrift.codegen.generate import GeneratedCode
from zerodrift.codegen.names import name_channels
from zerodrift.export.integer_model import Channel, IntegerModel

Files = dict[str, str]
"""Path inside the package, with forward slashes -> text."""


@dataclass(frozen=True)
class Given:
    """An input as a package's user gives it: in its unit, or as the code that the C converts."""

    channel: Channel
    field: str
    """In the C's struct."""
    in_unit: bool

    @property
    def unit(self) -> str:
        """The channel's unit; empty for a code of the hardware."""
        return self.channel.unit if self.in_unit else ""

    @property
    def lsb(self) -> float:
        """What a code is worth in what is given."""
        return self.channel.lsb if self.in_unit else 1.0

    @property
    def offset(self) -> float:
        """What code 0 stands for, in what is given."""
        return self.channel.offset if self.in_unit else 0.0

    @property
    def no_reading(self) -> int | None:
        """The code that says so, if the channel has one."""
        return self.channel.raw_lacks[0] if self.channel.raw_lacks else None


def list_given(model: IntegerModel) -> list[Given]:
    """Return the inputs in the order of the C's struct."""
    return [
        Given(channel, field, channel.conversion is None or channel.conversion.is_plain)
        for channel, field in zip(model.channels, name_channels(model), strict=True)
    ]


def split_code(code: GeneratedCode, runtime: Mapping[str, str]) -> tuple[Files, Files]:
    """Return headers and sources."""
    every = {code.header_name: code.header, code.source_name: code.source, **runtime}
    headers = {name: text for name, text in every.items() if name.endswith(".h")}
    return headers, {name: text for name, text in every.items() if name.endswith(".c")}


def lay_out(code: GeneratedCode, runtime: Mapping[str, str]) -> Files:
    """Return headers in include/ and sources in src/."""
    headers, sources = split_code(code, runtime)
    return {f"include/{n}": t for n, t in headers.items()} | {
        f"src/{n}": t for n, t in sources.items()
    }
