"""The explorer: a page in the browser with a regime map and the motion in the cell that is pointed at.

`subject` computes maps and runs, `pictures` and `curves` what is drawn of them, `newest` in which thread; these know
nothing of pages. `mapfigure` and `runfigures` draw with Bokeh, `controls` are the sliders, `page` wires them together,
and `server` serves the page to this machine alone.
"""
