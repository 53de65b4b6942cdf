"""A humanoid in MuJoCo, without graphics."""
