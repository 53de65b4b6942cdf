"""Tasks: their life, outcomes, leases, history and specifications."""
