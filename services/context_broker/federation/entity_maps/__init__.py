"""Entity maps: the ids that answer a query, kept so that its pages stay the same."""
