"""Franka's arms, FR3 and Panda."""
