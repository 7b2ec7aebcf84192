"""The laboratory: twins, the paper, other methods; imports the product, never the reverse."""
