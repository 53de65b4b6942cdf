"""A request while the broker carries it out: parameters, negotiation, routing, responses."""
