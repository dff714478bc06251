"""A study: the TOML of a config as frozen, validated values, and the sweep that it asks for.

Knows keys, units, rules, presets, axes, draws and designs; nothing of how a driveline moves.
"""
