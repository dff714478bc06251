"""The numerical core: a switched linear system, its flow, its events, and what they amount to.

Nothing here knows files, units of the config or people; it imports numpy, numba and its llvmlite only. One load step,
in reading order: `regimes` (the system as data), `switching` (preload, and what happens at an event), then one of two
methods, and `events` (what a run leaves behind), `sequence` and `severity` (label, Q and V), `tile` (many runs), `jit`
(how all of it is compiled).

`rk4`: `propagator` (full steps as matrices), `step` and `quartic` (one short step with everything in it located), `run`
(from preload to end), `settling` (when a run is over). `exact`: `flows` (the regimes' modes, as tables), `run` (and
what it does at an event), `stride` (its steps) and `search` (what it looks for within one), by `rows` (of numbers),
`curves` (moving along the modes) and `polynomial`. `lanes`: `pool` and `queues` of the runs under way, in `vectors`.
"""
