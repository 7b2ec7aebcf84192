"""Comparison with the measurements, evidence, and the verdict: which effect the model lacks."""
