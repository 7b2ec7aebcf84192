"""The operations a compensator is made of, each in one place: float, integer, C and range faces."""
