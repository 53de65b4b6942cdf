"""Reporting: statistics, open incidents and lists of processes, by SQL. Nothing here changes a process.

Modules, lowest first: `period` (the time that a report is about), `rollups` (the counts by hour and by day),
`element_times`, `throughput`, `work`, `open_incidents` (one table each), `process_filter` (the conditions of
a list of processes).
"""
