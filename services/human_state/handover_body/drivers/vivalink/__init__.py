"""The Vivalink patch, by the service of its vendor."""
