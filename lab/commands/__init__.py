"""The laboratory's commands, registered by entry points."""
