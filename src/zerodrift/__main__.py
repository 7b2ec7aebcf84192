"""`python -m zerodrift` is the command line."""

from zerodrift.app.cli import main

main()
