"""`python -m oysterbench`: the command."""

from oysterbench.cli.main import main

main()
