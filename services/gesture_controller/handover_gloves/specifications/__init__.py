"""Specifications: TaskDefinitions that are looked up when neither Task nor broker has them."""
