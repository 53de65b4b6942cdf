"""Walking patterns: where a person wants to go, where the feet step, how the centre of mass moves."""
