"""From the trained compensator to the integer model, its NumPy reference and its golden vectors."""
