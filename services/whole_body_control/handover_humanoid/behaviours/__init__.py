"""What a humanoid does: standing and walking."""
