"""Converter codes and test weights to the calibration matrix."""
