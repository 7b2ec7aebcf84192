"""Logs that are neither text nor Parquet, by their libraries: the extra `formats`."""
