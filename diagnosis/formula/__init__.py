"""Where the catalogue ends: formulas grown from the chip's operations, and which of them holds."""
