"""Recordings of others and of ours, replayed at their pace: WFDB, EDF, XDF, MCAP, CSV."""
