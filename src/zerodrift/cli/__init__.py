"""The command line: options make a task's request, text and JSON come from its result."""
