"""Measurements that the documentation quotes; run by `make bench`, never timed tests."""

from zerodrift.base.threads import use_one_thread

use_one_thread()
