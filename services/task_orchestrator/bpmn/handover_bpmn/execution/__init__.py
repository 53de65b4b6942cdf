"""Execution: the token engine. It is pure: no I/O, no clock of its own, no knowledge of Tasks and brokers.

Modules, lowest first: `graph` (a scope prepared for execution), `state` (tokens, frames, waits and their
snapshot), `machine` (creation, movement and cancellation of tokens; variables), `waits` (timers, messages,
signals, conditions), `compensation`, `propagation` (errors and escalations), `navigation` (sequence flows
and gateways), `activities`, `events`, `run` (the interface).
"""
