"""One module per command; each turns options into calls of a stage and prints the result."""
