"""SciPy's recursive filter without the rest of `scipy.signal`.

Importing `scipy.signal` brings statistics, interpolation and the documentation of some 800
functions with it, which takes longer than reading and fitting a small project. The filter itself is
one function in C, in a module of its own; it is loaded alone, and gives the same bits since it is
the same code.
"""

from collections.abc import Callable, Sequence
from functools import cache
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path

import numpy as np
import scipy

from zerodrift.base.arrays import Array

PLACE, MODULE, FUNCTION = "signal", "_sigtools", "_linear_filter"
"""Where SciPy keeps it; checked when it is loaded, for the names are SciPy's own affair."""


def filter_recursively(
    b: Sequence[float], a: Sequence[float], x: Array, state: Array | None = None
) -> Array:
    """Return x filtered along its last axis: a0 y[n] = sum b_i x[n-i] - sum a_i y[n-i], i > 0.

    Args:
        b: coefficients of the input.
        a: coefficients of the output, at least two.
        x: [..., n].
        state: [..., order] of the direct form II transposed before the first sample; None: zero.

    Source: scipy.signal.lfilter, whose bits these are.
    """
    taken = np.array(b, dtype=np.float64), np.array(a, dtype=np.float64)
    run = load_filter()
    found = run(*taken, x, -1) if state is None else run(*taken, x, -1, np.asarray(state))
    return found[0] if isinstance(found, tuple) else found


@cache
def load_filter() -> Callable[..., Array | tuple[Array, Array]]:
    """Return SciPy's filter: its C function alone, or `lfilter` where there is none of that name.

    Both take b, a, x, the axis and, where it is given, the state.
    """
    found = PathFinder.find_spec(MODULE, [str(Path(folder) / PLACE) for folder in scipy.__path__])
    if found is not None and found.loader is not None:
        try:
            module = module_from_spec(found)
            found.loader.exec_module(module)
            return getattr(module, FUNCTION)  # type: ignore[no-any-return]
        except (ImportError, AttributeError):
            pass  # a SciPy that keeps it elsewhere: its public function is as right, only slower
    from scipy.signal import lfilter

    return lfilter  # type: ignore[no-any-return]
