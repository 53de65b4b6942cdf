"""The trajectory tool: Tasks become robot motion."""
