"""The laboratory's commands, which the command line finds by an entry point of its package."""

COMMANDS: dict[str, tuple[str, str]] = {
    "twin": (
        "Write simulated logs of the six-axis sensor.",
        "zerodrift_lab.commands.twin:command",
    ),
    "paper": (
        "The paper's tables and its fit figure, from the twin.",
        "zerodrift_lab.commands.paper:command",
    ),
}
"""Name -> one-line help, and where the command is."""
