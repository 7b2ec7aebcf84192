"""What the page runs in separate processes: survey, diagnosis, and the firmware's C for the page.

python -m zerodrift.cli.page survey|diagnose|chip PROJECT RESULT [--skip-invalid] [--sensor NAME]

All write into the directory RESULT and report by an event when a file there is complete.
"""

import json
import os
import sys
from pathlib import Path

import numpy as np

from zerodrift.base.errors import ZerodriftError
from zerodrift.base.progress import Lines, Progress
from zerodrift.base.records import to_json
from zerodrift.report.findings import save_findings
from zerodrift.tasks.survey import diagnose_once, list_contributions, survey_project
from zerodrift.workbench.events import (
    CHIP_READY,
    DIAGNOSED,
    DIAGNOSIS,
    PREVIEWED,
    SENSOR,
    SKIP_INVALID,
    SURVEYED,
    name_preview,
)
from zerodrift.workbench.jobs import EVENT_MARK

PREVIEWS = 4
PROGRESS = Progress(Lines())


def survey(directory: Path, result: Path, skip_invalid: bool, sensor: str | None) -> None:
    """Write the findings, with the diagnosis where one for these logs is kept."""
    findings = survey_project(
        directory,
        sensor=sensor,
        skip_invalid=skip_invalid,
        wants_diagnosis=False,
        wants_advice=False,
        say=PROGRESS,
    )
    PROGRESS("writing")
    save_findings(findings, result)
    _tell(SURVEYED)


def diagnose(directory: Path, result: Path, skip_invalid: bool, sensor: str | None) -> None:
    """Write the diagnosis, and then the curves of the effects that it names."""
    from zerodrift.physics.catalogue import load_catalogue
    from zerodrift.tasks.project import ProjectFolder, open_project
    from zerodrift.tasks.survey import trace_provenance

    config, dataset = open_project(ProjectFolder(directory, sensor, skip_invalid), PROGRESS)
    catalogue = load_catalogue(config.plugin_files)
    mark = trace_provenance(config, dataset).mark
    found = diagnose_once(config, dataset, catalogue, mark, True, PROGRESS)
    text = json.dumps(to_json(found), ensure_ascii=False, allow_nan=False)
    (result / DIAGNOSIS).write_text(text, encoding="utf-8")
    _tell(DIAGNOSED)
    if found is None:
        return
    if hasattr(os, "nice"):  # not on Windows
        os.nice(10)  # the verdict is on the page; what is drawn with it comes before further curves
    for told in list_contributions(config, dataset, catalogue, found.diagnosis, PREVIEWS, PROGRESS):
        for run, curve in told.curves.items():
            np.save(name_preview(result, told.effect, run), curve, allow_pickle=False)
        _tell(PREVIEWED)


def chip(directory: Path, result: Path, skip_invalid: bool, sensor: str | None) -> None:
    """Write the firmware's C as WebAssembly, the runs, and the reference's answers."""
    from zerodrift.tasks.chip import prepare_chip
    from zerodrift.tasks.project import ProjectFolder

    prepare_chip(ProjectFolder(directory, sensor, skip_invalid), result, PROGRESS)
    _tell(CHIP_READY)


def _tell(event: str) -> None:
    print(f"{EVENT_MARK}{event}", flush=True)


def main() -> None:
    """Do what the arguments say; a user's error is one message on stderr."""
    what, directory, result = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    options = sys.argv[4:]
    skip_invalid = SKIP_INVALID in options
    sensor = options[options.index(SENSOR) + 1] if SENSOR in options else None
    try:
        do = {"survey": survey, "diagnose": diagnose, "chip": chip}[what]
        do(directory, result, skip_invalid, sensor)
    except ZerodriftError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:
        print(f"error: {error.filename or directory}: {error.strerror}.", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
