"""Types of arrays, by what they hold."""

import numpy as np
import numpy.typing as npt

Bools = npt.NDArray[np.bool_]
Codes = npt.NDArray[np.int64]  # of labels and of other outcomes; numbers of cells
Floats = npt.NDArray[np.float64]
Nodes = npt.NDArray[np.int64]  # their numbers, see `clunk.analysis.triangles`
Patterns = npt.NDArray[np.uint64]  # flanks of a sequence as bits behind a leading 1; 0 of a failed run
Positions = npt.NDArray[np.intp]  # in another array
Records = npt.NDArray[np.void]
