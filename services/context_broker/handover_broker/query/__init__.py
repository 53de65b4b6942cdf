"""Filters, orders and pages of queries: `q`, geo-queries, scopes, types, linked entities, indexes."""
