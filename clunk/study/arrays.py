"""Types of arrays, by what they hold."""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Bools = npt.NDArray[np.bool_]
Cells = npt.NDArray[np.int64]  # their numbers in C order
Codes = npt.NDArray[np.int64]  # of labels and of other outcomes
Counts = npt.NDArray[np.int32]
Flanks = npt.NDArray[np.int8]  # +1 opposite, -1 initial, 0 none
Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
LabelCodes = npt.NDArray[np.int16]  # of a map's labels, -1 of a failed cell
Nodes = npt.NDArray[np.int64]  # their numbers, see `clunk.analysis.lines`
Patterns = npt.NDArray[np.uint64]  # flanks of a sequence as bits behind a leading 1; 0 of a failed run
Positions = npt.NDArray[np.intp]  # in another array
Records = npt.NDArray[np.void]
