"""Indexes of the values and the places of one attribute, and the conditions of a query that they evaluate."""
