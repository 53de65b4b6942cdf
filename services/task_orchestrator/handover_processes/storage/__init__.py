"""Storage: the tables of the orchestrator, the transaction of a step, and queries."""
