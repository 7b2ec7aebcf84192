"""Records logs: readings of a source become rows, safe against a kill, and their coverage."""
