"""Allocation: which person, robot or device performs an activity. It is pure: no I/O, no clock of its own.

Modules, lowest first: `mapping` (the table from names in process files to performers), `agents` (Devices and
Persons with their skills), `choice` (the choice among them), `allocator` (the decision about one activity).
"""
