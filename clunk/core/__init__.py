"""The numerical core: a switched linear system, its flow, its events, and what they amount to.

Nothing here knows files, units of the config or people; it imports numpy, numba and its llvmlite only. One load step,
from preload to label: `tile.run_tile`, `switching.preload` and `begin_run`, a method's `run`, at each event
`switching.switch` and `runs.record` (is it primary?), `tile._finish` (pattern, Q and V), and `sequence.label`.

In reading order: `tables` (elements, and regimes as combinations of their states), `regimes` (the system as data, with
`equilibrium`: its steady motion, `reductions`: coordinates of what can move, and `batches`: many at once), `events` and
`runs` (what a run begins with and leaves behind, and `status`: how it ended), `switching` (preload, and what happens at
an event), `rigid` (impacts and releases of rigid flanks), `rubbing` (which flanks stay locked and which frictions stick
then), then one of two methods, and `sequence` (which impacts are primary, and the label), `tile` (many runs, and their
Q and V), `jit` (how all of it is compiled, once for all drivelines), `partial` (all that reaches into numba's inner
parts, without which it takes longer), `references` (systems and workspaces as arguments), `arrays` (their types) and
`sums`. Kernels allocate nothing: what calls them makes their room. `simulation.driveline` prepares the system, and the
tables of a method.

Both methods share the system, its guards, the preload, what happens at an event (`switching`, `rigid`, `rubbing`), the
label, and the modes by which RK4 knows that nothing follows, at all or for some steps. They differ in how they flow,
and locate events and extremes. That they agree says nothing of what they share; `tests/helpers/reference.py`, which
shares nothing, checks that, and `tests/test_rk4.py` holds runs to those in which every step is seen.

`rk4`: `run` (a run from the load step to its end, and when it is over), `step` and `quartic` (one step with
everything in it located), `propagator` (full steps as matrices).

`exact`: `run` (a run, and what it does at an event), `step` (propose a span, prove it, or find the event), `search`
(what is looked for within a step), `margins` (how near a run came to another label), `curves` (functionals and their
bounds), `moving` (along the modes), `taylor` (series over the shortest span), `flows` (the tables of modes),
`functionals` (what is read of them: of one driveline, or of each run's own), `rows` and `workspace` (a run's numbers).

`lanes`: `vectors` and `pool`, by which many runs take their steps side by side.

`measures` walks over a finished run whose states were kept, along `channels` (quantities as series in time, tabulated
in `simulation.measures`); nothing of a run depends on it.

A sweep enters by `tile.run_tile`: for each cell `_begin`, then `run.begin` and `run.advance` of the exact method or
`rk4.run.run`, and at the end `_finish`, which packs the primaries' flanks into a `pattern`; a single run is a tile of
one cell. `sweeping.reduction.labels_of` unpacks the pattern, and `sequence.label` makes the
label.

Words
-----
element     a lash, a staged shaft or a friction: its torque is linear in pieces, in one of its states at a time
batch       drivelines that are alike but for numbers, whose runs may take steps together
flow        x' = A x + B u, with its functionals; regimes may share one
functional  a number that is linear in the state and the inputs: the gap of a lash, its contact force, an acceleration
regime      a state of each element: a flow, the sides of the flanks in contact, and the guards that end it
guard       a functional, signed and shifted, that is positive within a regime and ends it where it turns negative
event       a guard turning negative, with the regime that follows; also the load step itself
phase       a time in one regime and under one piece of the load
inputs      d = (T, φ/2, …) of a run; u = (T, s φ/2, …) of a regime
window      from one primary impact of a lash to its next, or the end, over which the acceleration's extremes make Q_i
margin      how near a lash came to another label: positive by what did not happen, negative by what did
turn        a point where a functional turns back; depth: how far a guard would fall beyond zero before it does
load step   the change of the torque at time zero
piece       of the load: a time in which its torque is a level, a slope and a wave; kink: where the next one begins
wave        two numbers carried with the state, which make a load's sinusoid or exponential (rk4: its ramps, too)
flank       one of the two sides of a lash; side: +1 or -1, the sign of q on it
leader      the first regime of a group, whose flow and guards are read for all of it
step        rk4: a step of the time grid; exact: a span, or a part of the shortest, that runs take together
span        one of a ladder of time intervals, two an octave, for which a flow's propagator is tabulated
origin      a particular solution of a flow, which the modal coordinates are measured from
steady      of a flow: the functionals of its origin rest under a constant torque; still: and so under this load
rolled      by what angle of the first inertia that rolls a run's angles, which are less that, have turned together
pair        two modal coordinates that belong together; their amplitude does not grow, but as `exact.flows` says
group       regimes with one flow and, but for the sides, the same guards, whose runs take steps together
miss        a turn of a guard above zero; grazing: one within rounding of zero, or an event that all but did not happen
sway        how far all pairs move a functional at most from now on
bar         how low a guard has to turn back to make the run's margin smaller
static      the overlap or the locking torque at rest in contact, which margins of a contact are relative to
sticking    a contact that lasts longer than the sticking time; also of a friction, whose twist rests
slot        the place of a run among those that are under way; follow: sending it on after a step or a search
lane        one of the numbers in a vector register; mask: an int whose bits are lanes
queue       runs, or searches, that wait for the same; pool: all queues, and the items taken from one of them
"""
