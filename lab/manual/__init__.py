"""The manual's site: what of it is made at build time, by the code that it describes."""
