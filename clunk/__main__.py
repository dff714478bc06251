"""`python -m clunk`: the command line."""

from clunk.cli import main

main()
