"""A camera's own matrix and lens."""
