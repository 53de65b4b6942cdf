"""The roof: the `handover` command, which alone may import every part below it."""
