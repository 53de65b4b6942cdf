"""A step of processes: collected, written in one transaction, and sent from the outbox."""
