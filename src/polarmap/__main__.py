"""`python -m polarmap` is the command line."""

from polarmap.cli import main

main()
