"""Compare, evidence, verdict: which effect the model lacks."""
