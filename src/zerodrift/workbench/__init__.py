"""The loop in a browser: a local page over the commands, which runs them as a user would."""
