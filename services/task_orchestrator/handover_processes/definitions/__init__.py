"""Definitions of processes: registered, offered by others, our own entities, started by timers."""
