"""Logs to runs: selects, reads, checks them and brings them to one sample period."""
