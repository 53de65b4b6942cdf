"""The screen: what operators in gloves and engineers at a laptop look at, and the server it comes from."""
