"""Reads at several sources: entities, temporal evolutions, types, entity maps, merged with the own ones."""
