"""Compares host C and every other back end with the reference: 0 LSB, or the first difference."""
