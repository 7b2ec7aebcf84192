"""Plans the next experiment."""
