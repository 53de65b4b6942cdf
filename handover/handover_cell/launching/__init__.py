"""Processes of a cell: started together, watched, restarted and stopped."""
