"""Descriptions, scaffolds and views of mappings and graphs, for the command line and the REST interface."""
