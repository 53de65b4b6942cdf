"""`python -m handover.cli` is `handover`."""

from handover.cli.main import main

main()
