"""The report says what the commands say, stands on its own, and is written whole or not at all."""

import base64
import csv
import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from tests.report.conftest import make_comparison

from zerodrift.base.records import to_dict
from zerodrift.base.sealed import render_sealed
from zerodrift.diagnosis.comparison_summary import RunSummary
from zerodrift.diagnosis.run_spread import measure_spread
from zerodrift.report.annex import list_annex
from zerodrift.report.findings import ARRAYS, load_findings, measure_rate, save_findings
from zerodrift.report.parts import MOST_PARTS, list_parts
from zerodrift.report.report import MOST_WORST, list_pictures, render_report
from zerodrift.tasks.built import read_certificate
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.report import summarise_survey
from zerodrift.tasks.survey import SurveyRequest, survey


class Reader(HTMLParser):
    """Collects what a page would fetch, the text outside of scripts, and its figures."""

    def __init__(self):
        super().__init__()
        self.fetched, self.text, self.data, self.tags = [], [], [], []
        self._script = None

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        told = dict(attributes)
        self.fetched += [told[name] for name in ("src", "href", "data") if name in told]
        if tag in ("script", "style"):
            self._script = told.get("type", tag)

    def handle_endtag(self, tag):
        if tag in ("script", "style"):
            self._script = None

    def handle_data(self, data):
        if self._script == "application/json":
            self.data.append(json.loads(data))
        elif self._script is None:
            self.text.append(data)


def read(page):
    reader = Reader()
    reader.feed(page)
    return reader


def test_report_fetches_nothing_and_its_policy_forbids_it(surveyed):
    page = render_report(surveyed[1])
    reader = read(page)
    assert all(t.startswith(("#", "data:text/csv;")) for t in reader.fetched)
    assert reader.tags.count("link") == reader.tags.count("script") == 0
    assert "default-src 'none'" in page
    assert "script-src" not in page
    assert len(page) < 1_500_000


def test_report_shows_the_numbers_of_the_commands(surveyed, zerodrift):
    project, findings = surveyed
    text = " ".join(read(render_report(findings)).text)
    compared = json.loads(zerodrift("compare", "-C", project.directory, "--json").out)
    assert to_dict(summarise_survey(findings, (), None))["compare"] == compared
    diagnosed = json.loads(zerodrift("diagnose", "-C", project.directory, "--json").out)
    assert diagnosed["advice"] == compared["advice"]
    diagnosed["advice"] = None
    for sentence in compared["advice"]["sentences"]:
        assert sentence in text
    diagnosed["command"] = diagnosed["command"].partition(" -C ")[0]
    assert to_dict(summarise_survey(findings, (), None))["diagnose"] == diagnosed
    assert f"The model lacks {diagnosed['effect']}" in text
    for told in compared["outputs"].values():
        assert f"{told['rmse_heldout']:.4g}" in text
        assert f"{told['noise_floor']:.4g}" in text
    for segment in compared["worst"][:MOST_WORST]:
        assert segment["pattern"] in text


def test_report_is_the_same_bytes_each_time(surveyed):
    project, findings = surveyed
    assert render_report(findings) == render_report(
        survey(SurveyRequest(ProjectFolder(project.directory)))
    )


def test_every_picture_of_the_report_has_words(surveyed):
    page = render_report(surveyed[1])
    labels = re.findall(r'<svg [^>]*role="img" aria-label="([^"]*)"', page)
    assert len(labels) == len(list_pictures(surveyed[1])) == page.count("<svg")
    assert all(len(label) > 20 for label in labels)


def test_parts_in_the_table_cover_each_run_and_are_those_of_the_samples(surveyed):
    traces = surveyed[1].traces
    parts = list_parts(traces, 0)
    for trace in traces:
        mine = [part for part in parts if part.run == trace.run]
        assert len(mine) == MOST_PARTS
        assert (mine[0].from_s, mine[-1].to_s) == (trace.time_s[0], trace.time_s[-1])
        third = mine[2]
        rows = (trace.time_s >= third.from_s) & (trace.time_s <= third.to_s)
        assert third.measured == np.mean(trace.drift[0, rows])
        assert third.left == np.mean(trace.error[0, rows])
        assert third.left_rms == np.sqrt(np.mean(np.square(trace.error[0, rows])))
        assert third.model == np.mean(trace.drift[0, rows] - trace.error[0, rows])
    many = list_parts(traces * 100, 0)
    assert {part.run for part in many} == {trace.run for trace in traces}
    assert len(many) == 100 * len(traces)


def test_lines_of_a_picture_differ_in_more_than_colour(surveyed):
    for name, picture in list_pictures(surveyed[1]).items():
        for panel in picture.panels:
            drawn = [(c.dash, c.width, c.mark) for c in panel.curves if c.name]
            drawn += [(c.mark, c.size) for c in panel.clouds if c.name]
            assert len(set(drawn)) == len(drawn), name


def test_annex_holds_every_table_and_its_numbers_are_plain(surveyed):
    files = {one.name: one for one in list_annex(surveyed[1])}
    assert {"errors.csv", "errors_per_run.csv", "candidates.csv", "files.csv"} <= set(files)
    for one in files.values():
        rows = list(csv.reader(io.StringIO(one.text)))
        assert len(rows) == one.rows + 1
        assert len({len(row) for row in rows}) == 1
        assert "−" not in one.text
    page = render_report(surveyed[1])
    for name, one in files.items():
        link = re.search(rf'href="data:[^,]*,([^"]*)" download="{re.escape(name)}"', page)
        assert base64.b64decode(link.group(1)).decode() == one.text


def test_annex_and_pictures_are_written_as_files(project, zerodrift):
    done = zerodrift(
        *("report", "-C", project.directory, "--no-diagnose", "--format", "svg"),
        *("--annex", project.directory / "tables", "--json"),
    )
    assert done.code == 0
    files = [Path(name) for name in json.loads(done.out)["files"]]
    assert {"Fz_cause.svg", "errors.csv"} <= {path.name for path in files}
    for path in files:
        text = path.read_text()
        assert text
        if path.suffix == ".svg":
            ElementTree.fromstring(text)
            assert "prefers-color-scheme: dark" in text


def test_errors_have_an_uncertainty_from_how_runs_differ():
    def run(rmse, use):
        return {"Fz": RunSummary(rmse, 5.0, 3.0, 0.9, 0.0, None, True, use)}

    runs = {"a": run(3.0, "test"), "b": run(4.0, "test"), "c": run(50.0, "train")}
    output = replace(make_comparison().outputs["Fz"], rmse_test=np.sqrt(12.5))
    compared = replace(make_comparison(), outputs={"Fz": output}, runs=runs)
    told = measure_spread(compared)["Fz"]
    scatter = np.std([9.0, 16.0], ddof=1) / np.sqrt(2.0)
    assert (told.runs, told.held_out) == (2, True)
    assert told.std_error == pytest.approx(scatter / (2.0 * np.sqrt(12.5)))
    alone = replace(compared, runs={"a": run(3.0, "test")})
    assert measure_spread(alone)["Fz"].std_error is None


def test_cause_is_in_the_report_with_what_the_named_effect_would_explain(surveyed):
    findings = survey(SurveyRequest(ProjectFolder(surveyed[0].directory), wants_contribution=True))
    page = render_report(findings)
    assert "thermal_lag would explain" in page
    assert "lag of temperature" in page


def test_text_of_the_user_cannot_become_markup(project, zerodrift):
    text = project.toml.read_text().replace('name = "cell"', 'name = "<script>alert(1)</script>"')
    project.toml.write_text(text)
    assert zerodrift("report", "-C", project.directory, "--no-diagnose").code == 0
    page = (project.directory / "report.html").read_text()
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert" in page


def test_simulated_logs_are_said_to_be(project, zerodrift):
    assert zerodrift("report", "-C", project.directory, "--no-diagnose").code == 0
    assert "Simulated data" not in (project.directory / "report.html").read_text()
    project.toml.write_text("# SIMULATED\n" + project.toml.read_text())
    assert zerodrift("report", "-C", project.directory, "--no-diagnose").code == 0
    assert "Simulated data" in (project.directory / "report.html").read_text()


def test_diagnosis_is_kept_until_the_logs_change(surveyed, monkeypatch):
    project, findings = surveyed
    monkeypatch.setattr("zerodrift.tasks.survey.find_verdict", None)
    again = survey(SurveyRequest(ProjectFolder(project.directory)))
    assert again.diagnosed == findings.diagnosed


def test_diagnosis_of_other_logs_is_not_shown(project, zerodrift):
    survey(SurveyRequest(ProjectFolder(project.directory)))
    log = project.directory / "logs" / "run_0.csv"
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[:-1]))
    shown = json.loads(zerodrift("report", "-C", project.directory, "--no-diagnose", "--json").out)
    assert shown["diagnose"] is None
    assert "Not diagnosed" in (project.directory / "report.html").read_text()


def test_findings_come_back_as_they_were_saved(surveyed, tmp_path):
    findings = surveyed[1]
    save_findings(findings, tmp_path)
    back = load_findings(tmp_path)
    assert replace(back, traces=()) == replace(findings, traces=())
    for old, new in zip(findings.traces, back.traces, strict=True):
        assert (old.run, old.held_out) == (new.run, new.held_out)
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(old, name), getattr(new, name))


def test_held_out_errors_of_the_traces_are_those_of_the_command(surveyed):
    findings = surveyed[1]
    error = np.concatenate([t.error[0] for t in findings.traces if t.held_out])
    told = findings.comparison.outputs[findings.outputs[0]].rmse_heldout
    assert np.sqrt(np.mean(error**2)) == pytest.approx(told, rel=1e-12)


def test_rate_of_a_ramp_is_its_slope():
    time_s = np.arange(500.0) * 2.0
    np.testing.assert_allclose(measure_rate(time_s, 20.0 + 0.05 * time_s, 2.0), 3.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--out", "missing/report.html"), "is no directory"),
        (("--out", "logs"), "is a directory"),
        (("--format", "png", "--out", "zerodrift.toml"), "is a file"),
    ],
)
def test_report_refuses_a_place_it_cannot_write(project, zerodrift, monkeypatch, arguments, words):
    monkeypatch.chdir(project.directory)
    before = project.read_all()
    done = zerodrift("report", *arguments)
    assert done.code == 2
    assert words in done.err
    assert project.read_all() == before


def test_pdf_without_a_browser_says_what_to_do(project, zerodrift, monkeypatch):
    monkeypatch.setenv("ZERODRIFT_BROWSER", "no-such-browser")
    done = zerodrift("report", "-C", project.directory, "--format", "pdf")
    assert done.code == 2
    assert "Install one" in done.err


def test_firmware_of_another_model_is_not_shown(surveyed, tmp_path, zerodrift):
    from tests.loop.conftest import write_project

    other = write_project(tmp_path, runs=3)
    build = other.directory / "build"
    build.mkdir()
    (build / "firmware.json").write_bytes(render_sealed({"model_hash": "0"}))
    findings = survey(SurveyRequest(ProjectFolder(other.directory), wants_diagnosis=False))
    assert findings.firmware is None
    assert "cannot be shown" in findings.firmware_note


def test_full_disk_is_a_message_and_leaves_the_old_report(project, zerodrift, monkeypatch):
    target = project.directory / "report.html"
    target.write_text("old")

    def fail(self, _):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", fail)
    done = zerodrift("report", "-C", project.directory, "--no-diagnose")
    assert done.code == 2
    assert "No space left" in done.err
    assert target.read_text() == "old"
    assert sorted(path.name for path in project.directory.iterdir()) == [
        "logs",
        "report.html",
        "zerodrift.toml",
    ]


def test_bounds_are_those_of_the_model_s_own_certificate(tmp_path):
    path = tmp_path / "certificate.json"
    assert "missing in build/" in read_certificate(path, "abc")[1]
    bounds = [
        {"where": "a", "low": -5, "high": 100, "bits": 8},
        {"where": "b", "low": 0, "high": 2**31 - 1, "bits": 32},
    ]
    lists = {name: [] for name in ("inputs", "invariants", "tables", "shifts")}
    whole = {"model": "abc", "prefix": "p", "files": {}, **lists, "bounds": bounds}
    path.write_text(json.dumps(whole))
    told, note = read_certificate(path, "abc")
    assert told.bounds == 2 and note == ""
    assert [b.where for b in told.tightest] == ["b", "a"]
    assert told.tightest[0].headroom_bits == 0.0
    assert "of another model" in read_certificate(path, "abd")[1]
    for damage in ('{"model": "abc"}', '{"model": "abc", "bounds": [3]}', "[]", '{"model": '):
        path.write_text(damage)
        told, note = read_certificate(path, "abc")
        assert told is None and "No bounds are shown" in note


def test_report_sets_samples_at_the_rails_aside_as_compare_does(project, zerodrift):
    for path in (project.directory / "logs").glob("run_*.csv"):
        header, *rows = path.read_text().splitlines()
        fields = [row.split(",") for row in rows]
        measured = sorted(float(row[2]) for row in fields)
        rail = measured[int(0.9 * len(measured))]
        for row in fields:
            row[2] = f"{min(float(row[2]), rail):.5f}"
        path.write_text("\n".join([header, *(",".join(row) for row in fields)]) + "\n")
    text = project.toml.read_text().replace(
        "[network]", '[[effect]]\nkind = "adc_saturation"\n\n[network]'
    )
    project.toml.write_text(text)
    findings = survey(SurveyRequest(ProjectFolder(project.directory), wants_diagnosis=False))
    compared = json.loads(zerodrift("compare", "-C", project.directory, "--json").out)
    assert to_dict(summarise_survey(findings, (), None))["compare"] == compared
