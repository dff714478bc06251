"""Types of arrays, named after their contents."""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Bools = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
IntArray = npt.NDArray[np.int64]
Positions = npt.NDArray[np.intp]  # indices into another array
Records = npt.NDArray[np.void]
RecordType = np.dtype[np.void]
StopFlag = npt.NDArray[np.uint8]  # (1,)  set to non-zero from another thread to abandon runs


def record_of(**fields: Any) -> RecordType:
    """The type of a record with these fields, aligned as compiled functions expect it."""
    return np.dtype([*fields.items()], align=True)
