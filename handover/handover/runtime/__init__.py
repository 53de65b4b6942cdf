"""The process of a service: clocks, retries, background work, processes, ports."""
