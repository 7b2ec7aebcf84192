"""Effects hidden in simulated logs, and what the diagnosis says of them."""
