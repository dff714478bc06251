"""A study: the TOML of a config as frozen, validated values, and the sweep that it asks for.

Knows keys, units, rules, presets, axes, draws and designs; nothing of how a driveline moves. A config passes through

- `document`: TOML and overrides to plain tables, dotted keys to places, keys to lines;
- `config`: preset, file and overrides merged, and what they imply filled in;
- `keys`: tables to the typed models of `models`, `loads`, `sweeps` and `tables`, their errors to sentences;
- `rules`: what ties tables to one another, in a `study`;
- `errors`: everything that is wrong, in one report.

`parameters` are the keys that measure something, by name; `designs` are the cells of a sweep;
`arrays` are the types of arrays here and in the rooms that build on this one.
"""
