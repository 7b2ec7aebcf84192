"""What to do next: planned experiments."""
