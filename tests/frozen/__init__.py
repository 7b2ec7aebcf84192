"""Bytes that no change of the house may touch: five models, from float parameters stored here."""
