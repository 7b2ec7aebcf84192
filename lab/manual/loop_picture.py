"""The README's picture: the loop and its result, on a simulated sensor.

python -m manual.loop_picture [FILE]

Walks the loop by its commands (twin, diagnose, add, firmware) and draws what they found: what is
left and what the named effect explains of it, the loop against temperature, the staircase of
errors down to the noise floor, and what the comparison of bits said.
"""

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from zerodrift.base.journal import write_text
from zerodrift.diagnosis.drivers import TEMPERATURE, DriftDriver
from zerodrift.report import cause
from zerodrift.report.pictures import draw_stairs
from zerodrift.report.results import read_result
from zerodrift.report.svg import AxisScale, Panel, Picture, render_svg
from zerodrift.report.window import Window
from zerodrift.tasks.project import ProjectFolder
from zerodrift.tasks.survey import SurveyRequest, survey
from zerodrift.verify.summary import FirmwareSummary

TARGET = Path(__file__).parents[2] / "docs" / "assets" / "loop.svg"
TWIN = ("--runs", "6", "--told", "zero_tempco", "--hidden", "thermal_lag", "--hidden", "creep")
SEED = "3"
WIDTH = 900.0
MOST_STEPS = 4
LINE = 19.0


def run(directory: Path, *arguments: str) -> str:
    """Return what a command prints."""
    command = [sys.executable, "-m", "zerodrift", *arguments, "-C", str(directory)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def draw_loop(directory: Path) -> Picture:
    """Return the picture of the loop on simulated logs, which are written into a directory."""
    run(directory, "twin", *TWIN, "--seed", SEED)
    first = survey(SurveyRequest(ProjectFolder(directory), wants_contribution=True))
    now, named = first, []
    for _ in range(MOST_STEPS):
        assert now.diagnosed is not None
        effect = now.diagnosed.diagnosis.effect
        if effect is None:
            break
        named.append(effect)
        run(directory, "add", effect, "--json")
        now = survey(SurveyRequest(ProjectFolder(directory)))
    built = read_result(run(directory, "firmware", "--json"))
    assert isinstance(built, FirmwareSummary)
    worst = first.comparison.worst[0]
    trace, k = first.find_trace(worst.run), first.outputs.index(worst.output)
    channels = cause.list_channels(first)
    suspects = cause.find_suspects(first, named[0], worst.output)
    assert first.contribution is not None
    view = cause.CauseView(
        trace=trace,
        output=worst.output,
        window=Window(worst.run),
        panes=(cause.LEFT, suspects[0].key),
        against=DriftDriver(TEMPERATURE),
        effect=named[0],
        contribution=first.contribution.curves[worst.run][k],
        width=WIDTH,
    )
    above = cause.draw_cause(
        view, first.comparison, channels, lambda one: cause.read_driven(first, trace, one)
    ).picture
    below = draw_stairs(now.steps, 540.0)
    top = above.height + 8.0
    panels = [replace(panel, top=panel.top + top) for panel in below.panels]
    told = _list_words(named, built)
    words = [
        Panel(
            left=560.0,
            top=top + 38.0 + LINE * number,
            width=330.0,
            height=1.0,
            x=AxisScale(0.0, 1.0, hidden=True, ticks=()),
            y=AxisScale(0.0, 1.0, hidden=True, ticks=()),
            title=line,
        )
        for number, line in enumerate(told)
    ]
    label = (
        f"Simulated sensor: what the model leaves and what {named[0]} explains of it, a loop "
        f"against temperature; errors falling step by step to the noise floor. {' '.join(told)}"
    )
    return Picture(WIDTH, top + below.height, (*above.panels, *panels, *words), label, "loop")


def _list_words(named: list[str], built: FirmwareSummary) -> list[str]:
    """Return what the commands said, line by line."""
    equal = "0 LSB different" if built.bit_exact else "DIFFERENT"
    return [
        f"diagnose named {', then '.join(named)}.",
        "add fitted each, judged on runs left out.",
        f"firmware: {' = '.join(built.backends)},",
        f"{built.vectors} steps, {equal};",
        f"{built.flash_bytes} B flash, {built.ram_bytes} B RAM ({built.core}).",
        "Simulated logs (zerodrift twin).",
    ]


def main() -> None:
    """Write the picture."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else TARGET
    with tempfile.TemporaryDirectory(prefix="zerodrift-loop-") as name:
        text = render_svg(draw_loop(Path(name) / "sensor"), alone=True)
    write_text(target, text + "\n", target.parent)
    print(f"Wrote {target}: {len(text)} bytes")


if __name__ == "__main__":
    main()
