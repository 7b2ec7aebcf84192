"""A second implementation of the integer arithmetic, written from the reference pages alone."""
