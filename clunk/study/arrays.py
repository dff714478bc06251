"""Types of arrays, by what they hold."""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Bools = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.int64]
Cells = Integers  # their numbers in C order
Codes = Integers  # of labels and of other outcomes
Nodes = Integers  # their numbers, see `clunk.analysis.lines`
Counts = npt.NDArray[np.int32]
Flanks = npt.NDArray[np.int8]  # +1 opposite, -1 initial, 0 none
Floats = npt.NDArray[np.float64]
LabelCodes = npt.NDArray[np.int16]  # of a map's labels, -1 of a failed cell
Positions = npt.NDArray[np.intp]  # in another array
Records = npt.NDArray[np.void]
