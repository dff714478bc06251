"""Run the command line, as `python -m clunk`."""

from clunk.cli import main

main()
