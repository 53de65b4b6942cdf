"""The operations of NGSI-LD on entities, subscriptions and @contexts; one use case in a module."""
