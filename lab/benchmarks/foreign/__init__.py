"""Hidden effects in logs of foreign making: a simulator that knows nothing of zerodrift's own.

Everything here was written from the catalogue's equations alone. It imports nothing of zerodrift
and drives it by its commands only; `python -m benchmarks.foreign` prints how often they are right.
"""
