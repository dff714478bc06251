"""Maps and runs of the report's driveline, by which the report's claims are checked."""

from functools import cache, cached_property

from clunk.analysis.fitted import Fitted
from clunk.analysis.fitting import fit
from clunk.analysis.measurements import ExperimentComparison, compare_experiment, read_experiment
from clunk.results.maps import Results
from clunk.simulation.driveline import Driveline, Modes
from clunk.simulation.trajectory import Trajectory, simulate
from clunk.study.config import study_from_text
from clunk.study.study import Study, replace_values
from clunk.sweeping.progress import ShowProgress
from clunk.sweeping.sweep import sweep

RATIOS = (1.0, 2.0, 5.0)  # load ratios of Figure 3.2
NOMINAL_RATIO, NOMINAL_BACKLASH = 5.0, 6.0  # load ratio, and degrees of backlash, of Figures 3.1, 3.3 and 3.6
CONTACTS = ("indentation", "restitution")

_DRIVELINE = '[driveline]\npreset = "boere-2008"\n'
_AXIS = '[[sweep.axes]]\nparameter = "{}"\nstart = 0.0\nstop = {}\ncount = {}\n'
# Fit of the gaps in the model to those of the rig: a factor on the measured gaps, and an offset in degrees.
_GAPS = """title = "Table 4.1 with the rig's gaps matched"
[fit]
candidates = 160
effective_draws = 100
draws = 1024
[[fit.parameters]]
parameter = "lash.backlash_deg"
distribution = "uniform"
draws = "factor"
low = 0.2
high = 10.0
[[fit.parameters]]
parameter = "lash.backlash_deg"
distribution = "uniform"
draws = "offset"
low = -0.1
high = 12.0
"""
_BY_RESTITUTION = 'lash.contact.model="restitution"'
_AS_PRINTED = 'driveline.preset="boere-2008-as-printed"'
MAPS = {  # name -> title, number of values on each axis, overrides of the config
    "indentation": ("Indentation Force Model", 201, []),
    "restitution": ("Restitution Coefficient Model, e = 0.5", 201, [_BY_RESTITUTION]),
    "by_force": ("Indentation Force Model, separation by force", 101, ['lash.contact.separation="force"']),
    "as_printed": ("Inertias of Table 2.2 as printed", 101, [_AS_PRINTED]),
}


Maps = dict[str, Results]  # of Figures 3.4 and 3.7 and their variants, by the names of `MAPS`


def run_maps(coarsen: int = 1, workers: int | None = None, progress: ShowProgress = False) -> Maps:
    """Run the sweeps of `MAPS`, by name.

    coarsen : number of intervals between values of an axis that become one
    progress : as in `clunk.sweep`, for each sweep separately
    """
    maps = {}
    for name, (title, count, overrides) in MAPS.items():
        values = (count - 1) // coarsen + 1
        axes = _AXIS.format("load.ratio", 10.0, values) + _AXIS.format("lash.backlash_deg", 20.0, values)
        text = f'title = "{title}"\n{_DRIVELINE}{axes}'
        study = study_from_text(text, source=f"the config of {title}", overrides=overrides)
        maps[name] = sweep(study, workers=workers, progress=progress)
    return maps


def _run(ratio: float, contact: str) -> Trajectory:
    text = f'title = "The nominal driveline"\n{_DRIVELINE}'
    overrides = [f"load.ratio={ratio!r}", f"lash.backlash_deg={NOMINAL_BACKLASH!r}", f'lash.contact.model="{contact}"']
    return simulate(study_from_text(text, source="the nominal config", overrides=overrides))


class Evidence:
    """Maps, runs and modes of the report's driveline, each computed once.

    maps : Maps
    runs : of Figure 3.2, by contact model and load ratio
    """

    def __init__(self, maps: Maps) -> None:
        self.maps = maps
        self.runs = {contact: {ratio: _run(ratio, contact) for ratio in RATIOS} for contact in CONTACTS}

    @property
    def nominal(self) -> Trajectory:
        """The run of Figures 3.1, 3.3 and 3.6, by the indentation model."""
        return self.runs["indentation"][NOMINAL_RATIO]

    @property
    def study(self) -> Study:
        """The study of the nominal run."""
        return self.nominal.study

    @cached_property
    def modes(self) -> Modes:
        """Closed-lash modes of the driveline with the inertias corrected."""
        return _closed_modes(self.study)

    @cached_property
    def printed_modes(self) -> Modes:
        """Closed-lash modes of the driveline with the inertias as printed."""
        return _closed_modes(study_from_text(_DRIVELINE, overrides=[_AS_PRINTED]))

    @cached_property
    def modes_of_forces(self) -> Modes:
        """Closed-lash modes where the shafts' stiffness and damping in N/m and N s/m act at the lash's radius."""
        scale = self.study.lashes[0].radius ** 2
        values = {
            f"driveline.shafts[{k}].{key}": scale * getattr(shaft, key)
            for k, shaft in enumerate(self.study.driveline.shafts, 1)
            for key in ("stiffness", "damping")
        }
        return _closed_modes(replace_values(self.study, values))

    @cached_property
    def damped_in_the_gap(self) -> Trajectory:
        """The nominal run with the contact's damping in the gap as well (report Eq. 2.5)."""
        lash, driveline = self.study.lashes[0], self.study.driveline
        damper = {"between": lash.between, "stiffness": 0.0, "damping": lash.radius**2 * (lash.contact.damping or 0.0)}
        shafts = (*driveline.shafts, driveline.shafts[0].but(**damper))
        damped = self.study.but(driveline=driveline.but(shafts=shafts))
        return simulate(replace_values(damped, {"lash.contact.damping": 0.0}))

    @cached_property
    def measured(self) -> ExperimentComparison:
        """Comparison of Table 4.1 with the map of the indentation model."""
        return compare_experiment(self.maps["indentation"], read_experiment("table_4_1"))

    @property
    def fitted(self) -> Fitted:
        """Fit of the rig's gaps in the model to Table 4.1, by the exact method."""
        return _gaps_fitted()


@cache
def _gaps_fitted() -> Fitted:
    study = study_from_text(_GAPS + _DRIVELINE, overrides=['solver.method="exact"'])
    return fit(study, read_experiment("table_4_1"))


def _closed_modes(study: Study) -> Modes:
    return Driveline.from_study(study).modes(closed=True)


def acceleration_range(run: Trajectory) -> tuple[float, float]:
    """Least and largest acceleration after the first primary impact  [rad/s2]."""
    window = run.extremes[run.primaries[0] :, run.lash]
    return window[:, 1].min(), window[:, 0].max()
