"""C equals the specification: both are run over terms, for every input and state."""
