"""Access: what a caller may do with the operations and entities of a tenant."""
