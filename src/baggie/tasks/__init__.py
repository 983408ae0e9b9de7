"""Tasks: what lies on the table, where, what counts, and what a demonstrator does about it."""
