"""Context source registrations: which source has which entities and attributes, and the subscriptions to
them."""
