"""The operations on registrations, on subscriptions to them and on entity maps."""
