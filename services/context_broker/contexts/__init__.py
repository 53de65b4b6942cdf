"""The @contexts: what the names that readers and writers use stand for."""
