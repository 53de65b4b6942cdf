"""Questions: which entities are wanted, in which order, and which page of them."""
