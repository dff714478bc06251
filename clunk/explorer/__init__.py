"""The explorer: a page in the browser with a regime map and the motion in the cell that is pointed at.

`subject` is what is explored and `variations` its maps and runs with other numbers; `pictures` and `curves` are what is
drawn of them, `newest` in which thread, `saving` the files of it; these know nothing of pages. `mapfigure` and
`runfigures` draw with Bokeh, `controls` are the sliders. `page` opens with the stored map alone, and imports the
`workbench`, which wires the rest together, when the browser has drawn that; `server` serves the page to this machine
alone.
"""
