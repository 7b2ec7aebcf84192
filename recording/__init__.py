"""Logs as they are recorded: a source's readings become rows, kept whole, and what they cover."""
