"""Training: the lag bank or a network that learns the drift the physical model leaves."""
