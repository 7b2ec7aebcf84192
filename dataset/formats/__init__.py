"""Logs that are neither text nor Parquet, by their libraries: `pip install zerodrift[formats]`."""
