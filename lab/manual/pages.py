"""Pages and files that are made from the code when the site is built."""

import inspect
from collections.abc import Callable, Iterator
from importlib import import_module

import click

from manual.notebooks import DOCS, list_notebooks, render_notebook
from zerodrift.cli.main import cli, list_commands

MODULES = {
    "effects": (
        "Declaring effects",
        "What a file of one's own effects uses; see how to write an effect of your own.",
        ("physics.effect", "physics.catalogue", "operations.backend"),
    ),
    "logs": (
        "Projects and logs",
        "zerodrift.toml and the logs as the commands read them.",
        ("base.config", "base.errors", "dataset.load", "dataset.runs"),
    ),
    "physics": (
        "Fit, compare, diagnose",
        "The loop behind the commands.",
        (
            *("physics.fit", "physics.model", "diagnosis.compare"),
            *("diagnosis.diagnose", "diagnosis.diagnosis", "diagnosis.revision"),
        ),
    ),
    "integers": (
        "Training and integers",
        "From a trained network to the integer model and its C.",
        (
            *("train.training", "train.compensator", "export.quantize"),
            *("export.integer_model", "export.reference", "codegen.generate", "verify.firmware"),
        ),
    ),
    "arithmetic": (
        "Integer arithmetic",
        "The operations whose bits are normative, with their ranges.",
        ("operations.arithmetic", "operations.intervals", "operations.gru", "operations.tables"),
    ),
    "report": (
        "Pictures and report",
        "One set of pictures for report, page and manual.",
        ("report.findings", "report.pictures", "report.report"),
    ),
}
"""Page -> its title, what it is about, and the modules on it."""


def render_commands() -> str:
    """Return the reference of the command line, from the commands' own help."""
    lines = [
        "# The commands",
        "",
        "Written from `zerodrift COMMAND --help` when the manual is built. Exit codes: 0 done; 1 a",
        "check failed (bits differ, a certificate refused); 2 bad input or usage. `--json` prints",
        "one object on stdout and nothing else there.",
        "",
        "| command | does |",
        "|---|---|",
        *(
            f"| [`{name}`](#zerodrift-{name}) | {help_line} |"
            for name, (help_line, _) in list_commands().items()
        ),
    ]
    context = click.Context(cli, info_name="zerodrift")
    for name in list_commands():
        command = cli.get_command(context, name)
        assert command is not None
        text = command.get_help(click.Context(command, info_name=name, parent=context))
        lines += ["", f"## zerodrift {name}", "", "```text", text.rstrip(), "```"]
    return "\n".join(lines) + "\n"


def render_modules(page: str) -> str:
    """Return the reference of some modules, for mkdocstrings to fill in."""
    title, about, modules = MODULES[page]
    lines = [f"# {title}", "", about, ""]
    for name in modules:
        module = import_module(f"zerodrift.{name}")
        assert inspect.getdoc(module), name
        lines += [f"::: zerodrift.{name}", ""]
    return "\n".join(lines)


def list_pages() -> Iterator[tuple[str, Callable[[], str]]]:
    """Yield every file that is made, and what makes it."""
    yield "reference/commands.md", render_commands
    for page in MODULES:
        yield f"reference/python/{page}.md", lambda page=page: render_modules(page)
    for path in list_notebooks():
        name = path.relative_to(DOCS).with_suffix(".md").as_posix()
        yield name, lambda path=path: render_notebook(path)


def write_pages() -> None:
    """Write them where MkDocs looks."""
    import mkdocs_gen_files

    for path, make in list_pages():
        with mkdocs_gen_files.open(path, "w", encoding="utf-8") as file:
            file.write(make())


if __name__ == "<run_path>":
    write_pages()
