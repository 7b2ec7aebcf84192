"""`python -m zerodrift` is the command line."""

from zerodrift.cli import main

main()
