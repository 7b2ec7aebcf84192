"""Mutants: the generated C and its runtime with one thing changed, and who notices."""
