"""Two answers to the same question: a regime map against another one, or against measurements.

Two maps of the same grid (other contact model, solver, driveline or machine) are compared cell by cell: where the
sequences of impacts differ, and how the severities do. Measurements, as in the report's Table 4.1, are compared with
the cells nearest to them, and by their trend: does the number of double-sided impacts change in the same direction?
"""

from clunk.analysis.comparison.maps import (
    Comparison,
    ComparisonError,
    ConfigDifference,
    Deviation,
    DifferingCell,
    Extreme,
    Transition,
    compare,
)
from clunk.analysis.comparison.measurements import ExperimentComparison, Point, Tally, Trend, compare_experiment
from clunk.analysis.comparison.records import as_record
from clunk.analysis.comparison.reporting import report
from clunk.analysis.experiments import ExperimentError, is_experiment, read_experiment

__all__ = [
    "Comparison",
    "ComparisonError",
    "ConfigDifference",
    "Deviation",
    "DifferingCell",
    "ExperimentComparison",
    "ExperimentError",
    "Extreme",
    "Point",
    "Tally",
    "Transition",
    "Trend",
    "as_record",
    "compare",
    "compare_experiment",
    "is_experiment",
    "read_experiment",
    "report",
]
