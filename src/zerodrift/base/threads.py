"""How many threads the numerical libraries may start; set before any of them is imported."""

import os

BLAS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def use_one_thread() -> None:
    """Let BLAS and OpenMP compute on one thread, unless the user's environment says otherwise.

    The products here are small: threads that must share their cores with other work spend nearly
    all their time waiting for each other. Has no effect on libraries that are loaded already.
    """
    for name in BLAS:
        os.environ.setdefault(name, "1")
