"""`python -m handover_cell` is `handover`."""

from handover_cell.main import main

main()
