"""Sessions of a therapist on the running humanoid: plans, exercises, their store and their entities."""
