"""Federation: context source registrations, operations distributed to them, and entity maps."""
