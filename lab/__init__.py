"""The laboratory: twins, the paper's experiments, other methods. Imports the product, never the reverse."""
