"""Cameras: what one must offer, and those there are."""
