"""Measurements that the documentation quotes; run by `make bench`, never timed tests."""

from zerodrift.threads import use_one_thread

use_one_thread()
