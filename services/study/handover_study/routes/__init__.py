"""REST of studies."""
