"""A wheelchair that is steered by leaning, and slower while the heart beats fast."""
