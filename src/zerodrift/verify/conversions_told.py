"""What `firmware` reports on the inputs whose raw codes the chip converts."""

from zerodrift.export.integer_model import Channel, IntegerModel
from zerodrift.verify.summary import ConversionSummary


def summarise_conversions(model: IntegerModel) -> dict[str, ConversionSummary]:
    """Return input -> how its raw codes are converted, of those that a table converts."""
    found = {channel.name: _summarise(channel) for channel in model.channels}
    return {name: told for name, told in found.items() if told is not None}


def _summarise(channel: Channel) -> ConversionSummary | None:
    by = channel.conversion
    if by is None or by.is_plain:
        return None
    low, high = (end * channel.lsb + channel.offset for end in (by.lowest, by.highest))
    return ConversionSummary(
        raw=by.raw,
        unit=channel.unit,
        covers=(low, high),
        readings=(by.begin, by.end),
        cold_junction=by.formula.junction,
        table_bytes=by.table_bytes,
        lsb=channel.lsb,
        error=by.error,
        code_worth=by.worth,
    )


def tell_conversions(model: IntegerModel) -> list[str]:
    """Return a line for each of them: the table, and where the hardware is the coarser."""
    lines = []
    for name, told in summarise_conversions(model).items():
        line = (
            f"{name} is converted from {told.raw} codes: {told.covers[0]:.4g} to"
            f" {told.covers[1]:.4g} {told.unit} within {told.error:.2g} {told.unit}, table of"
            f" {told.table_bytes} B"
        )
        if told.cold_junction is not None:
            line += f"; its cold junction is {told.cold_junction}"
        if told.code_worth[1] > told.lsb:
            line += (
                f"; one raw code is worth {told.code_worth[0]:.2g} to {told.code_worth[1]:.2g}"
                f" {told.unit}, the result's code {told.lsb:.2g}"
            )
        lines.append(line)
    return lines
