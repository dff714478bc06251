"""The numerical core: a switched linear system, its flow, its events, and what they amount to.

Nothing here knows files, units of the config or people; it imports numpy, numba and its llvmlite only. One load step,
in reading order: `regimes` (the system as data), `switching` (preload, and what happens at an event), then one of two
methods, and `events` (what a run leaves behind), `sequence` and `severity` (label, Q and V), `tile` (many runs), `jit`
(how all of it is compiled).

By rk4: `steps` (full steps as matrices), `step` and `polynomial` (one short step with everything in it located), `rk4`
(a run from preload to end), `settling` (when a run is over). Exactly: `flows` (the regimes' modes, as tables), `exact`
(a run, and what it does at an event), `stride` (its steps) and `search` (what it looks for within one), many runs of a
`pool` side by side: `rows` (their numbers) and `queues` (what they wait for), `abreast` (moving along the modes) by
`lanes`, and `polynomial` again where one of them needs its own way.
"""
