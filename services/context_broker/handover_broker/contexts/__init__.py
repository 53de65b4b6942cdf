"""The @contexts that the broker ships, hosts and caches, and the names they define."""
