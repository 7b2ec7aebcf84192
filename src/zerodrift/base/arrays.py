"""What arrays are called, and arrays as the bytes of one npz file."""

import io
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def pack_arrays(arrays: Mapping[str, NDArray[np.generic]], *, compressed: bool) -> bytes:
    """Return the content of an npz file; the same arrays give the same bytes.

    Raises:
        MemoryError: there is no memory for it.
    """
    buffer = io.BytesIO()
    save = np.savez_compressed if compressed else np.savez
    try:
        save(buffer, allow_pickle=False, **arrays)
    except ValueError as error:
        # The archive is closed while a member is open, and complains of that instead.
        if isinstance(error.__context__, MemoryError):
            raise error.__context__ from None
        raise
    return buffer.getvalue()
