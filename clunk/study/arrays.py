"""Array types, named after their contents."""

import numpy as np
import numpy.typing as npt

from clunk.core.arrays import (
    Array as Array,
    Bools as Bools,
    FloatArray,
    IntArray,
    Positions as Positions,
    Records as Records,
    RecordType as RecordType,
    record_of as record_of,
)

Integers = IntArray
Cells = Integers  # numbers of cells in C order
Codes = Integers  # codes of labels and of other outcomes
Nodes = Integers  # numbers of nodes, see `clunk.analysis.triangles`
Counts = npt.NDArray[np.int32]
Flanks = npt.NDArray[np.int8]  # +1 opposite, -1 initial, 0 none
Floats = FloatArray
LabelCodes = npt.NDArray[np.int16]  # codes of a map's labels; -1 for a failed cell
