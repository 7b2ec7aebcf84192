"""Figures, tables and the report: everything that shows what the commands found."""
