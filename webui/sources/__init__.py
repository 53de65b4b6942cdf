"""Sources: where what the screen shows comes from, one module a source.

A source follows its part of the cell until it is cancelled, and tells the world what it sees there.
"""
