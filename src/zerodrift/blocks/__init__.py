"""One program per design, a block of coefficients per unit: formats, the set of blocks, files."""
