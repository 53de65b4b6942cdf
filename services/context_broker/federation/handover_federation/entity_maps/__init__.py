"""Entity maps: the ids of the entities that match a query, kept so that its pages stay consistent."""
