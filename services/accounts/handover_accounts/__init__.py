"""Accounts: people, their rights, sessions and tokens, and the audit log of all of that."""
