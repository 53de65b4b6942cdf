"""The door: how a request is read, refused or answered, whatever it is about."""
