"""Figures, tables and the report: everything that presents the results of the commands."""
