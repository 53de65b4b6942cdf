"""What is measured: commands that print medians, p99 and the ratio to what is asked for."""
