"""A quotation mark costs no row without a word."""

import warnings

import pytest

HEADER = ("time_s", "temperature_degC", "Fz_N", "ref_Fz_N", "remark")


def remark(rows, remarks):
    """Return the rows with a remark each: those given by position, "ok" elsewhere."""
    return [[*row, remarks.get(k, "ok")] for k, row in enumerate(rows)]


@pytest.mark.parametrize("skip_invalid", [False, True])
@pytest.mark.parametrize(
    "remarks",
    [
        {10: '5" pipe'},
        {10: '5" pipe', 20: '6" pipe'},
        {10: '"5 pipe'},
        {10: '"a"b"', 20: '"ok"'},
        {10: 'a"', 11: '"b"'},
    ],
)
def test_lone_quotation_mark_is_refused_with_its_line(project, rows, remarks, skip_invalid):
    project.write_log(remark(rows(), remarks), header=HEADER)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        message = project.refusal(skip_invalid=skip_invalid)
    assert message.startswith("log.csv:12: a quotation mark ")
    assert "expected them in pairs around a field" in message


@pytest.mark.parametrize(
    "text",
    [
        '"quoted"',
        'say "hi" to',
        '"in ""two"" words"',
        '"over\ntwo lines"',
        '"over\n""three""\nlines"',
    ],
)
def test_quotation_marks_in_pairs_cost_no_row(project, rows, text):
    project.write_log(remark(rows(), {10: text, 30: text}), header=HEADER)
    (run,) = project.load().train
    assert len(run) == len(rows())


def test_mark_that_is_never_closed_is_found_without_reading_the_rest(project, rows, monkeypatch):
    monkeypatch.setattr("zerodrift.dataset.tables._LONGEST_FIELD_BYTES", 100)
    project.write_log(remark(rows(), {10: '5" pipe', 30: '6" pipe'}), header=HEADER)
    assert project.refusal().startswith("log.csv:12: a quotation mark opens a field")
