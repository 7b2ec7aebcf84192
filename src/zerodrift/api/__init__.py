"""The Python face: a project with the tasks as methods."""
