"""What can be said about each command: nothing here takes long to import, so help and completion come at once."""
