"""A simulated person with a glove, who answers the Tasks on the screen of the controller."""
