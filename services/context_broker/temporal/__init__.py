"""The past: how entities have been, kept, corrected, asked and summed up."""
