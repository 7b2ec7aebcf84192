"""The report says what conversions of raw codes cost, beside the rest of the error budget."""

from tests.operations.test_thermocouple import make_model

from zerodrift.report.tables import tabulate_conversions
from zerodrift.verify.errors_told import summarise_conversions
from zerodrift.verify.summary import ErrorCauses, ProvenError


def test_each_conversion_has_a_line_and_its_share_of_the_bound_is_told() -> None:
    told = summarise_conversions(make_model("K", converted=True))
    causes = ErrorCauses(0.0, 0.0, 0.25, 0.0, 0.0, 0.0, conversion=0.25)
    bound = ProvenError(value=0.5, unit="N", holds="any input", causes=causes)
    table = tabulate_conversions(told, {"Fz": bound})
    assert [row[0] for row in table.rows] == ["x0", "x1"] == list(told)
    for row, one in zip(table.rows, told.values(), strict=True):
        assert len(row) == len(table.headings)
        assert row[1:3] == ("degC", one.raw) and row[-1] == str(one.table_bytes)
        assert row[4] == f"{one.error:.2g}" and row[5] == f"{one.lsb:.2g}"
    assert "What conversions are of the proven bound: Fz 0.25 N." in table.note
    assert "proven bound" not in tabulate_conversions(told, None).note
