"""Solvers of a hierarchy of least squares under bounds, behind one interface."""
