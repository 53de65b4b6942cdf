"""REST of the machines."""
