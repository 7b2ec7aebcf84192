"""The error bound, derived again from the C's expressions and the float model's parameters."""
