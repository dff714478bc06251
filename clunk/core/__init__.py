"""The numerical core: a switched linear system, its flows and events, and the labels and quantities of its runs.

The core knows nothing of files, units of the config or users; it imports numpy, numba and numba's llvmlite only. One
load step passes, from preload to label, through `tile.run_tile`; `switching.preload` and `begin_run`; the `run` of a
method; at each event `switching.switch` and `runs.record` (which decides whether it is a primary impact);
`tile._finish` (pattern, Q and V); and `sequence.label`.

In reading order: `tables` (elements, and regimes as combinations of their states), `regimes` (the system as data, with
`equilibrium`: its steady motion, `reductions`: coordinates of what can move, and `batches`: many at once), `events` and
`runs` (what a run begins with and leaves behind, and `status`: how it ended), `switching` (preload, and what happens at
an event), `rigid` (impacts and releases of rigid flanks), `rubbing` (which flanks stay locked and which frictions stick
then), then one of two methods, and `sequence` (which impacts are primary, and the label), `tile` (many runs, and their
Q and V), `jit` (how the core is compiled, once for all drivelines), `partial` (the use of numba's private parts,
without which compiling takes longer), `references` (systems and workspaces passed to compiled functions by reference),
`arrays` (types of arrays) and `sums`. Kernels allocate nothing: their callers provide all arrays. Outside the core,
`simulation.system` prepares the system and its tables of modes, and `simulation.batches` the tables of RK4.

Both methods share the system, its guards, the preload, what happens at an event (`switching`, `rigid`, `rubbing`), the
label, and the modes, by whose amplitudes RK4 proves that nothing can follow at all, or within some steps. The methods
differ in how they advance the state and locate events and extremes. Their agreement does not test the parts that they
share; `tests/helpers/reference.py`, which shares no code with clunk, does, and `tests/test_rk4.py` compares RK4's runs
with runs that inspect each step.

`rk4`: `run` (a run from the load step to its end, and the proof that nothing can follow), `step` and `quartic` (one
step, with every event and extreme in it located), `propagator` (full steps as matrices).

`exact`: `run` (a run, and what it does at an event), `step` (propose a span, prove it, or find the event), `search`
(extremes and turns within a step), `margins` (how near a run came to another label), `curves` (functionals and their
bounds), `moving` (modal coordinates advanced in time), `taylor` (series over the shortest span), `modes` (of a flow:
energy coordinates and eigenvectors), `flows` (their tables), `functionals` (functionals by these tables: of one
driveline, or of a driveline for each lane), `rows` and `workspace` (a run's numbers).

`lanes`: `vectors` and `pool`, by which many runs take their steps side by side.

`measures` walks over a finished run whose states were kept, along `channels` (quantities as series in time, tabulated
in `simulation.measures`); no other result of a run depends on it.

A sweep enters by `tile.run_tile`: for each cell `_begin`, then `run.begin` and `run.advance` of the exact method or
`rk4.run.run`, and at the end `_finish`, which packs the primaries' flanks into a `pattern`; a single run is a tile of
one cell. `sweeping.reduction.labels_of` unpacks the pattern, and `sequence.label` makes the label.

Words
-----
element     a lash, a staged shaft or a friction: its torque is piecewise linear, and linear in each of its states
batch       drivelines of one structure that differ in numbers only, whose runs may take steps together
flow        x' = A x + B u, with its functionals; several regimes may share a flow
functional  a number that is linear in the state and the inputs: the gap of a lash, its contact force, an acceleration
regime      a state of each element: a flow, the sides of the flanks in contact, and the guards that end it
guard       a functional, signed and shifted, that is positive within a regime and ends it where it turns negative
event       a guard turning negative, with the regime that follows; also the load step itself
phase       the time from one event to the next, in one regime; stretch: the part of it under one piece of the load
inputs      d = (T, φ/2, …) of a run; u = (T, s φ/2, …) of a regime
window      from one primary impact of a lash to its next, or the end, over which the acceleration's extremes make Q_i
margin      how near a lash came to another label: positive for an event that did not happen, negative for one that did
turn        a local extremum of a functional in time; depth: how far below zero a guard would fall before its turn
load step   the change of the torque at time zero
piece       an interval in which the load's torque is a level, a slope and a wave; kink: where the next piece begins
wave        two numbers appended to the state that make a load's sinusoid or exponential (rk4: its ramps, too)
flank       one of the two sides of a lash; side: +1 or -1, the sign of q on it
leader      the first regime of a group, whose flow and guards stand for the whole group
step        rk4: a step of the time grid; exact: a span, or a part of the shortest span, that runs take together
span        one of a ladder of time intervals, two per octave, for which a flow's propagator is tabulated
origin      the particular solution of a flow from which its modal coordinates are measured
steady      flow whose functionals of the origin are constant under a constant torque; still: constant under this load
rolled      the angle of the first inertia that rolls by which the driveline has turned as a whole; a run's angles are
            stored less their share of it
pair        two modal coordinates of one 2 x 2 block; their amplitude never grows, but as `exact.flows` says
group       regimes with one flow and, but for the sides, the same guards, whose runs take steps together
miss        a turn of a guard above zero; grazing: a turn so near zero that rounding decides whether there is an event
sway        bound on how far all pairs together can move a functional from its origin from now on
static      overlap or locking torque at rest in contact, to which the margins of a contact are relative
sticking    a contact that lasts longer than the sticking time; of a friction: its twist does not change
slot        the row of a run among those under way; follow: queue or end a run after its step or its last search
lane        one of the numbers in a vector register; mask: an int whose bits are lanes
queue       runs, or searches, that wait for the same operation; pool: all queues, and the items taken from one of them
"""
