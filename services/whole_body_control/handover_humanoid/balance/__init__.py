"""Balance: where the robot is, which forces hold it, and how it answers a push."""
