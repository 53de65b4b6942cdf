"""Tasks: what robots are asked to do, step by step, and the performers that carry it out."""
