"""Measurements that the documentation quotes; run by `make bench`, never timed tests."""
