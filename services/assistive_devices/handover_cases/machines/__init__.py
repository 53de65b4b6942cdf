"""The machines of the cases, one folder each."""
