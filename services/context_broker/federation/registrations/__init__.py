"""Context sources: who else knows something, and what of."""
