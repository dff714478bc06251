"""The numerical core: a switched linear system, its flow, its events, and what they amount to.

Nothing here knows files, units of the config or people; it imports numpy and numba only. One load step, in reading
order: `regimes` (the system as data), `polynomial` (where a guard turns negative within a step), `rk4` (a run from
preload to end), `events` (what it leaves behind), `sequence` and `severity` (label and Q), `tile` (many runs).
"""
