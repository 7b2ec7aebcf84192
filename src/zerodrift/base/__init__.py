"""Configuration, errors and files: what every stage imports."""
