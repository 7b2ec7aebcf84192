"""`python -m zerodrift` is the command line."""

from zerodrift.cli.main import main

main()
