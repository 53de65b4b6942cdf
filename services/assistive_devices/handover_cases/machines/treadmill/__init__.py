"""The treadmill trainer: a belt that follows the walker, and a coach for the heart rate."""
