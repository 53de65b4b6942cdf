"""`python -m handover_cell` is `handover`."""

from handover.command_line.main import main

main()
