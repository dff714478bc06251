"""Thresholds of vanishing backlash on the axes of a map, by all modes of the locked chain (report §3.2)."""

from clunk.results.maps import Map
from clunk.simulation.linear import rigid_contact_thresholds, thresholds_on
from clunk.study.config import study_from_text
from clunk.study.study import replace_values


def thresholds_of(results: Map) -> list[float]:
    """Values of the swept load at which one more impact appears as the backlash vanishes.

    They are those of the first load ratio or torque that changes, for a driveline in which all other keys have the
    values of these results; empty where there is none, where shafts have friction, of which the linear view knows
    nothing, and of several lashes, which do not open one by one.
    """
    if results.lashes:
        return []
    changing = (axis.parameter for axis in results.axes if len(axis.values) > 1)
    parameter = next((name for name in changing if name.startswith("load.")), None)
    if parameter is None:
        return []
    study = study_from_text(results.config, source="the results file's config")
    if any(shaft.friction for shaft in study.driveline.shafts):
        return []
    fixed = {axis.parameter: float(axis.values[0]) for axis in results.parameters if len(axis.values) == 1}
    study = replace_values(study, fixed)
    return [float(value) for value in thresholds_on(study, parameter, rigid_contact_thresholds(study))]
