"""The analysis of a study, and its reports as table and on paper."""
