"""The explorer: a page in the browser with a regime map and the motion in the cell under the pointer.

`subject` holds the explored results, and computes maps and runs with other numbers of the config; `newest` is the
thread that does so. `figures` draws the map and the runs with Bokeh, `controls` has the sliders; `workbench` is the
page, which connects these, and `server` serves the page to this machine alone.
"""
