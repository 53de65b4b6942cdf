"""Process: one run of a definition, from its start to its end, and its Tasks."""
