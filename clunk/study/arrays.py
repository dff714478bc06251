"""Types of arrays, by what they hold."""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Bools = npt.NDArray[np.bool_]
Cells = npt.NDArray[np.int64]  # their numbers in C order
Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Positions = npt.NDArray[np.intp]  # in another array
Records = npt.NDArray[np.void]
