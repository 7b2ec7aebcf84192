"""Reference = host C (and every other back end): 0 LSB, or a report of the first difference."""
