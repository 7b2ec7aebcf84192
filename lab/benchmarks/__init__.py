"""Measurements that the documentation quotes; run by `make bench`, never timed tests."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from zerodrift.base.threads import use_one_thread

use_one_thread()


def open_pool(jobs: int) -> ProcessPoolExecutor:
    """Return a pool of processes started anew; one forked beside threads may wait for ever."""
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
