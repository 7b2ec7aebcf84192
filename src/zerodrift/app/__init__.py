"""The command line: calls the stages in order and shows what they return."""
