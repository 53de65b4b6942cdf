"""Messages, signals and changes of entities: which process each belongs to, and their delivery."""
