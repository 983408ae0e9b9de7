"""The Ravens benchmark: its recordings read and written, its agents."""
