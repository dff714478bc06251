"""The numerical core: a switched linear system, its flow, its events, and what they amount to.

Nothing here knows files, units of the config or people; it imports numpy and numba only. One load step, in reading
order: `regimes` (the system as data), `switching` (preload, and what happens at an event), `polynomial` and `step` (one
short step with everything in it located), `rk4` (a run from preload to end), `settling` (when a run is over), `events`
(what it leaves behind), `sequence` and `severity` (label, Q and V), `tile` (many runs), `jit` (how all of it is
compiled).
"""
