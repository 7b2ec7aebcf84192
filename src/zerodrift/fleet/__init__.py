"""Hundreds of sensors of one design, each from its logs to checked firmware."""
