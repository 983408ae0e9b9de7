"""The published regressor."""
