"""Persons: pseudonyms, consents, sensors and robots of each."""
