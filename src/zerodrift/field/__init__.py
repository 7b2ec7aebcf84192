"""Units in use: monitoring their compensated output, and the registry of units."""
