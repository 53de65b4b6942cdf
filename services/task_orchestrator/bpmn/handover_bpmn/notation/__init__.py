"""Notation: reads a BPMN 2.0 file into the neutral model, and reports all faults at once.

Modules, lowest first: `faults` (collection of faults and warnings), `document` (safe parsing of the XML),
`elements` (the structure of BPMN: contents of scopes, definitions of messages and errors, pools),
`dialects` (extension elements and expression languages: ours, Camunda 7, Zeebe, jBPM), `nodes` (a table of
the flow nodes, each with its reader and rules), `scopes` and `rules` (subprocesses and processes), `file`
(`read_bpmn`).

An element that changes the execution and is not supported is a fault that names it: a process never does
less than its drawing. An element without effect on the execution is a warning. The reader continues after a
fault. It records the elements with faults as broken, and the rules skip these, so that one fault has no
follow-ups.
"""
