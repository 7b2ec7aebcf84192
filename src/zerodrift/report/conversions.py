"""The report's table of inputs whose raw codes the chip converts."""

from collections.abc import Mapping

from zerodrift.report.tables import Table, write_number
from zerodrift.verify.summary import ConversionSummary, ProvenError


def tabulate_conversions(
    conversions: Mapping[str, ConversionSummary], bounds: Mapping[str, ProvenError] | None
) -> Table:
    """Return what each conversion costs, beside the rest of the error budget.

    Args:
        conversions: input -> how its raw codes are converted; at least one.
        bounds: output -> its proven bound, which holds the conversions' share.
    """
    rows = tuple(
        (
            name,
            told.unit,
            told.raw,
            " to ".join(write_number(end) for end in told.covers),
            write_number(told.error, 2),
            write_number(told.lsb, 2),
            " to ".join(write_number(worth, 2) for worth in told.code_worth),
            str(told.table_bytes),
        )
        for name, told in conversions.items()
    )
    headings = (
        *("input", "unit", "given", "covers", "largest error"),
        *("one code of the result", "one raw code is worth", "table, B"),
    )
    shares = [
        f"{name} {write_number(bound.causes.conversion, 2)} {bound.unit}"
        for name, bound in (bounds or {}).items()
        if bound.causes is not None
    ]
    note = (
        "Largest error: to the sensor's formula over every code that is covered, rounding included."
        " The worth of a raw code is the hardware's resolution; no arithmetic regains it."
    )
    if shares:
        note += f" What conversions are of the proven bound: {', '.join(shares)}."
    return Table("Conversion of raw codes", headings, rows, texts=4, note=note)
