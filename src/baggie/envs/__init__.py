"""Gymnasium environments: one step is one whole pick and place."""
