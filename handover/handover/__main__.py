"""`python -m handover` is `handover`."""

from handover.command_line.main import main

main()
