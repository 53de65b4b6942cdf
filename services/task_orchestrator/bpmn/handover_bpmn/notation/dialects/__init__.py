"""Dialects: the extension elements and expression languages of vendors, behind one interface.

`base` is the interface, `handover`, `camunda7` and `zeebe` are the dialects; `choice` selects one for a file.
"""
