"""A study: the TOML of a config as frozen, validated values, and the sweep that it asks for.

This package knows keys, units, rules, presets, axes, draws and designs; nothing of how a driveline moves. A config
passes through

- `document`: TOML and overrides to plain tables, dotted keys to places, keys to lines;
- `config`: preset, file and overrides merged, and what they imply filled in;
- `keys`: tables validated by the typed models of `models`, `loads`, `sweeps` and `tables`, errors as sentences;
- `rules`: constraints between tables, checked for every `study`;
- `errors`: all errors of a config, in one report.

`parameters` are the numeric keys that can be swept, drawn or replaced, by name; `designs` are the cells of a sweep;
`arrays` are array types of this package and of those that build on it.
"""
