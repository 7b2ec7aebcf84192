"""Formulas beyond the catalogue of effects, built from the chip's operations, and their
judgement."""
