"""The code cells of a notebook, run in this process by IPython, without a kernel or a socket.

python -m manual.cells NOTEBOOK ANSWERS: writes what each code cell gave, as a list in JSON.

A kernel is spoken to over sockets, which a builder without a network may not have; a cell of the
manual needs none. The folder that this is started in is the cells' own.
"""

import json
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

Bundle = dict[str, object]
"""One output in several forms: content type to content."""


@dataclass(frozen=True)
class CellAnswer:
    """What one code cell gave."""

    printed: str = ""
    shown: list[Bundle] = field(default_factory=list)
    """In order: what it displayed, and the value of its last line."""
    failed: str = ""
    """Type and text of the error that ended it, or nothing."""


def read_cells(path: Path) -> list[tuple[str, str]]:
    """Return (kind, source) of each cell of a notebook file."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return [(cell["cell_type"], "".join(cell["source"])) for cell in cells]


def run_cells(sources: list[str]) -> list[CellAnswer]:
    """Run code cells in one namespace; the first that fails is the last of the answers."""
    from IPython.core.displayhook import DisplayHook
    from IPython.core.interactiveshell import InteractiveShell
    from IPython.utils.capture import capture_output
    from traitlets.config import Config

    class ShowLast(DisplayHook):
        """Shows the value of a cell's last line as `display` does."""

        def __call__(self, result: object = None) -> None:
            if result is not None and not self.quiet():
                self.shell.display_pub.publish(*self.compute_format_data(result))

    class Shell(InteractiveShell):
        displayhook_class = ShowLast

    config = Config()
    config.IPythonDisplayFormatter.enabled = False
    config.HistoryManager.enabled = False
    shell = Shell.instance(config=config, colors="nocolor")
    answers = []
    for source in sources:
        with capture_output() as got:
            result = shell.run_cell(source, store_history=False)
        error = result.error_before_exec or result.error_in_exec
        failed = "" if error is None else f"{type(error).__name__}: {error}"
        shown = [each.data for each in got.outputs]
        answers.append(CellAnswer("" if failed else got.stdout + got.stderr, shown, failed))
        if failed:
            break
    return answers


def main(notebook: str, answers: str) -> None:
    """Run one notebook; see the module."""
    given = run_cells([source for kind, source in read_cells(Path(notebook)) if kind == "code"])
    Path(answers).write_text(json.dumps([asdict(each) for each in given]), "utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
