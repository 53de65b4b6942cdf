"""The registry: what each device is, its token, and its entities."""
