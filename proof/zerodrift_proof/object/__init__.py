"""Kernels in assembly are the specification, from the bytes of a linked program."""
