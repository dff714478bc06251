"""The explorer: a page in the browser with a regime map and the motion in the cell that is pointed at.

`subject` is what is explored, and its maps and runs with other numbers; `newest` is the thread that computes them.
`figures` draws map and runs with Bokeh, `controls` are the sliders; `workbench` is the page, which wires these
together, and `server` serves it to this machine alone.
"""
